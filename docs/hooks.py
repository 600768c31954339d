"""MkDocs' hooks: pages made from the code, pages from the top folder, and the drawing."""

import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from docs.generate import filled  # noqa: E402
from docs.rooms_drawing import drawn  # noqa: E402

FROM_TOP = {
    "SECURITY.md": "security.md",
    "CONTRIBUTING.md": "contributing.md",
    "CODE_OF_CONDUCT.md": "code-of-conduct.md",
    "CHANGELOG.md": "changelog.md",
}
"""Pages of the top folder, and where the site has them."""


def on_files(files: Files, config: Any) -> Files:
    """Adds the pages of the top folder."""
    for source, page in FROM_TOP.items():
        content = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=relinked(content)))
    return files


def relinked(text: str) -> str:
    """A page of the top folder, with links as they are within the site."""
    for source, page in FROM_TOP.items():
        text = text.replace(f"]({source})", f"]({page})")
    text = text.replace(
        "](docs/examples/own_cost_term.py)", "](examples.md#an-own-cost-term)"
    )
    text = text.replace("](docs/", "](")
    # What is no page of the site is named, not linked.
    return re.sub(r"\[([^\]]+)\]\(\.github/[^)]*\)", r"`\1`", text)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fills in what is made from the code, and draws the rooms."""
    return drawn(filled(markdown))
