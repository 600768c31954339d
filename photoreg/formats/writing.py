"""Files written together: all of them, or none and the old ones stay."""

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path

from photoreg.checks import check_output_file
from photoreg.errors import OutputError


def write_files(
    contents: Mapping[Path, bytes | str | Callable[[], bytes]],
) -> list[Path]:
    """Writes files whole or not at all; text as UTF-8.

    The first is the one that refers to the others, and is put in place last. What is
    large can be given as a function, called when its turn has come.

    Raises:
        OutputError: if one cannot be written.
    """
    for path in contents:
        check_output_file(path, (path.suffix.lower(),))
    partials = {path: path.with_name(path.name + ".part") for path in contents}
    try:
        for path, partial in partials.items():
            content = contents[path]
            if callable(content):
                content = content()
            partial.write_bytes(
                content.encode() if isinstance(content, str) else content
            )
        for path, partial in reversed(partials.items()):
            partial.replace(path)
    except OSError as error:
        for partial in partials.values():
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
        first = next(iter(contents))
        raise OutputError(
            f"Cannot write {first}: {error.strerror or error}."
        ) from error
    return list(contents)


def make_folder(folder: Path) -> Path:
    """Makes a folder whose parent exists; an existing one is taken as it is.

    Raises:
        OutputError: if it cannot be made, or is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"Cannot write into {folder}: it is a file, not a folder.")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot make the folder {folder}: {error.strerror or error}."
        ) from error
    return folder
