"""Which of several files are the cameras: dropped together, or out of a zip."""

from pathlib import Path

from photoreg.errors import InputError
from photoreg.formats.cameras.realityscan import is_realityscan
from photoreg.formats.cameras.registry import SINGLE_FILE_SUFFIXES, format_of_json
from photoreg.sources import open_for_reading


def find_camera_file(folder: Path) -> Path:
    """The one camera file, or folder of COLMAP, texrecon or RealityScan, somewhere in a folder.

    Raises:
        InputError: if there is none, or more than one.
    """
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    named = [path for path in files if path.suffix.lower() in SINGLE_FILE_SUFFIXES]
    found = [path for path in named if _is_of_cameras(path)]
    found += [place for place in sorted({p.parent for p in files}) if _is_model(place)]
    if not found and len(named) == 1:
        return named[0]  # Whoever reads it will say what is wrong with it.
    if len(found) == 1:
        return found[0]
    if not found:
        names = ", ".join(path.name for path in files[:6]) or "nothing"
        raise InputError(
            f"No cameras are among {names}. COLMAP's are cameras and images together, "
            "both .bin or both .txt; Bundler's are .out and list.txt together."
        )
    places = ", ".join(path.relative_to(folder).as_posix() for path in found)
    raise InputError(
        f"There are {len(found)} sets of cameras: {places}. Give the one you want."
    )


def _is_model(folder: Path) -> bool:
    """Whether a COLMAP model, or texrecon's or RealityScan's files, lie in just this folder."""
    return (
        any(folder.glob("*.cam"))
        or any(map(is_realityscan, folder.glob("*.xmp")))
        or any(
            all((folder / f"{p}{suffix}").is_file() for p in ("cameras", "images"))
            for suffix in (".bin", ".txt")
        )
    )


def _is_of_cameras(path: Path) -> bool:
    """Whether a file's content is that of cameras, as far as its beginning shows."""
    if path.suffix.lower() in (".json", ".sfm"):
        return format_of_json(path) is not None
    beginnings = {".mlp": b"<", ".xml": b"<", ".out": b"# Bundle file"}
    with open_for_reading(path) as file:
        start = file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")
    return start.startswith(beginnings.get(path.suffix.lower(), b"%YAML"))
