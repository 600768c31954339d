"""Files written together, all of them or none; what is the user's stays as it is.

Never written over: what the command reads, by whatever name or link it is reached. Not
written over unless asked to: what does not carry photoreg's mark. A link is replaced
itself; nothing is written through it.
"""

import contextlib
import filecmp
import os
import secrets
import shutil
import unicodedata
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path

from photoreg.checks import inputs_read
from photoreg.errors import OutputError
from photoreg.formats.mark import is_marked
from photoreg.sources import open_for_reading, read_regular
from photoreg.words import listed

Content = bytes | str | Callable[[], bytes] | Path
"""Bytes; text, as UTF-8; what is large as a function, called when its turn has come;
or a file to be copied."""

NOTHING: Mapping[Path, Content] = {}
"""No other files."""


def write_files(
    contents: Mapping[Path, Content],
    inputs: Iterable[Path] = (),
    overwrite: bool = False,
) -> list[Path]:
    """Writes files whole or not at all.

    Args:
        contents: What each file is to hold. The first is the one that refers to the
            others, and is put in place last.
        inputs: Files that must stay as they are, beside those that the command read.
        overwrite: Whether files without photoreg's mark may be replaced.

    Raises:
        OutputError: if one cannot be written, or something is in its way.
    """
    there = _check(list(contents), inputs, overwrite, contents)
    partials: dict[Path, Path] = {}
    path = next(iter(contents))
    try:
        for path, content in contents.items():
            if path in there:
                continue
            partial = _unused(path.parent, "part")
            with partial.open("xb") as file:
                partials[path] = partial
                if isinstance(content, Path):
                    with open_for_reading(content) as source:
                        shutil.copyfileobj(source, file, 1 << 20)
                else:
                    file.write(_bytes(content))
                file.flush()
                os.fsync(file.fileno())
            if path.is_file() and not path.is_symlink():
                shutil.copymode(path, partial)
        _put_in_place(partials)
    except OSError as error:
        raise OutputError(f"Cannot write {path}: {error.strerror or error}.") from error
    finally:
        for partial in partials.values():
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
    return list(contents)


def check_outputs(
    paths: Sequence[Path], inputs: Iterable[Path] = (), overwrite: bool = False
) -> None:
    """Checks that files can be written, before the long work that makes them.

    Args:
        paths: Every file that will be written, the one asked for first.
        inputs: Files that must stay as they are, beside those that the command read.
        overwrite: Whether files without photoreg's mark may be replaced.

    Raises:
        OutputError: if a folder is missing or cannot be written, or something is in the
            way; the sentence names all of it.
    """
    _check(paths, inputs, overwrite, {})


def check_suffix(path: Path | str, suffixes: Collection[str]) -> Path:
    """Returns ``path`` if its suffix is one of these.

    Raises:
        OutputError: if it is another.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise OutputError(
            f"Cannot write {path}: its suffix should be {' or '.join(suffixes)}, "
            f"but is {path.suffix or 'missing'}."
        )
    return path


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


def _check(
    paths: Sequence[Path],
    inputs: Iterable[Path],
    overwrite: bool,
    contents: Mapping[Path, Content],
) -> set[Path]:
    """Returns those of ``paths`` that hold their contents already, and may stay.

    Raises:
        OutputError: as `check_outputs` does.
    """
    folding: dict[Path, bool] = {}
    there = set()
    written: dict[tuple[str, str], Path] = {}
    read = {_identity(path) for path in (*inputs, *inputs_read())} - {None}
    named: dict[str, list[str]] = {"inputs": [], "foreign": [], "unusual": []}
    for path in paths:
        if path.is_dir():
            raise OutputError(f"Cannot write {path}: it is a folder; give a file name.")
        if path.parent not in folding:
            folding[path.parent] = _folds_case(path)
        key = os.path.realpath(path.parent), _name(path, folding[path.parent])
        if key in written:
            raise OutputError(
                f"Cannot write {path}: {written[key].name} would be written to the same "
                "place. Choose another name."
            )
        written[key] = path
        try:
            kind = _in_the_way(path, read, overwrite)
            content = contents.get(path)
            # Of an input, only a copy of itself is no attempt to write over it.
            may_stay = kind == "foreign" or isinstance(content, Path)
            if kind and may_stay and _holds(path, content):
                there.add(path)
            elif kind:
                named[kind].append(path.name)
        except OSError as error:
            raise _no_place(path, error) from error
    _refuse(paths[0], **named)
    return there


def _refuse(
    first: Path, inputs: list[str], foreign: list[str], unusual: list[str]
) -> None:
    """Says in one sentence all that is in the way, if anything is."""
    parts = []
    if inputs:
        parts.append(f"{listed(inputs)} {_are(inputs)} read by this command")
    if foreign:
        parts.append(f"{listed(foreign)} {_are(foreign)} there and not photoreg's")
    if unusual:
        parts.append(f"{listed(unusual)} {_are(unusual)} no ordinary file")
    if not parts:
        return
    # Even asked to, it would not replace the others.
    may_be_replaced = foreign and not inputs and not unusual
    remedy = ", or overwrite what is there (--overwrite)" if may_be_replaced else ""
    raise OutputError(
        f"Cannot write {first}: {', and '.join(parts)}. Choose another name{remedy}."
    )


def _are(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _in_the_way(
    path: Path, read: Collection[tuple[int, int] | None], overwrite: bool
) -> str:
    """What kind of file is in the way of ``path``; "" if none is."""
    if not os.path.lexists(path):
        return ""
    if not path.exists():  # A link that leads nowhere.
        return "" if overwrite else "foreign"
    if _identity(path) in read:
        return "inputs"
    if not path.is_file():
        return "unusual"
    if overwrite or is_marked(path):
        # Renaming onto a file replaces it even where it is write-protected.
        with path.open("r+b"):
            return ""
    return "foreign"


def _holds(path: Path, content: Content | None) -> bool:
    """Whether a file already holds what is to be written, so that nothing is lost."""
    if content is None or callable(content) or not path.is_file():
        return False
    if isinstance(content, Path):
        return filecmp.cmp(path, content, shallow=False)
    expected = _bytes(content)
    return path.stat().st_size == len(expected) and read_regular(path) == expected


def _bytes(content: bytes | str | Callable[[], bytes]) -> bytes:
    if callable(content):
        content = content()
    return content.encode() if isinstance(content, str) else content


def _identity(path: Path) -> tuple[int, int] | None:
    """The same for every name and link of one file; None if there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def _name(path: Path, folds_case: bool) -> str:
    name = unicodedata.normalize("NFC", path.name)
    return name.casefold() if folds_case else name


def _folds_case(path: Path) -> bool:
    """Whether the folder of ``path`` takes capital and small letters for the same.

    Raises:
        OutputError: if nothing can be written there.
    """
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(
            f"Cannot write {path}: the folder {folder} does not exist. Make it first."
        )
    trial = _unused(folder, "trial")
    try:
        # Only a trial shows it: permission bits mislead for root and on network drives.
        trial.touch(exist_ok=False)
        folds = trial.with_name(trial.name.upper()).exists()
        trial.unlink()
    except OSError as error:
        raise _no_place(path, error) from error
    return folds


def _no_place(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"Cannot write {path}: {error.strerror or error}. Choose another place."
    )


def _unused(folder: Path, suffix: str) -> Path:
    return folder / f"photoreg-{secrets.token_hex(6)}.{suffix}"


def _put_in_place(partials: Mapping[Path, Path]) -> None:
    """Renames all, the first last; if one cannot be, brings the old ones back."""
    old: dict[Path, Path] = {}
    placed = []
    try:
        for path, partial in reversed(list(partials.items())):
            if len(partials) > 1 and os.path.lexists(path):
                old[path] = _second_name(path)
            partial.replace(path)
            placed.append(path)
    except BaseException:
        for path in placed:
            if path in old:
                old.pop(path).replace(path)
            else:
                path.unlink()
        raise
    finally:
        for path in old.values():
            with contextlib.suppress(OSError):
                path.unlink()
    for folder in {path.parent for path in partials}:
        _sync_folder(folder)


def _second_name(path: Path) -> Path:
    second = _unused(path.parent, "old")
    try:
        os.link(path, second, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(path, second, follow_symlinks=False)
    return second


def _sync_folder(folder: Path) -> None:
    """Puts new names on the disk; Windows does so by itself and opens no folders."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
