"""The files of `static/`: templates and scripts of pages, and the demo."""

from pathlib import Path


def static_folder() -> Path:
    """Where they are: within an installed photoreg, beside it in a checkout."""
    installed = Path(__file__).parents[1] / "static"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "static"


def static_text(name: str) -> str:
    """The text of one of them."""
    return (static_folder() / name).read_text(encoding="utf-8")
