"""Several files as one zip: packed for a download, and unpacked within bounds."""

import errno
import lzma
import shutil
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

from photoreg.checks import check_input_file
from photoreg.errors import InputError, OutputError
from photoreg.limits import Limits
from photoreg.sources import open_for_reading

COMPRESSED = (".png", ".jpg", ".jpeg", ".glb")
MAX_MEMBERS = 20_000
DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, ValueError)
"""What zipfile raises of a damaged file; ValueError of names that are no UTF-8."""
TOGETHER = 4
"""All files of a zip may be so many times the size of one."""


def zipped(folder: Path, files: Sequence[Path]) -> bytes:
    """Files of ``folder`` as one zip; pictures, compressed already, are stored."""
    target = folder / ".download.zip"
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in files:
            is_compressed = path.suffix.lower() in COMPRESSED
            archive.write(
                path,
                path.relative_to(folder).as_posix(),
                zipfile.ZIP_STORED if is_compressed else zipfile.ZIP_DEFLATED,
            )
    content = target.read_bytes()
    target.unlink()
    return content


def unzipped(path: Path, folder: Path, wanted: Callable[[str], bool]) -> list[Path]:
    """Unpacks the wanted files of a zip into ``folder``, in their folders.

    Args:
        path: The zip.
        folder: Where they go; nothing is written outside of it.
        wanted: Told the file name of a member, without its folders, whether to take it.

    Raises:
        InputError: if it is not a zip, is damaged or encrypted, holds a file or all
            together more than the limits say, or more than 20,000 files, or names
            that no disk takes.
        OutputError: if the files cannot be written.
    """
    unpacked = []
    check_input_file(path, "archive")
    try:
        with open_for_reading(path) as file, zipfile.ZipFile(file) as archive:
            members = [
                member
                for member in archive.infolist()
                # Not by is_dir(), which fails at a name of no letters.
                if not member.filename.endswith("/") and wanted(_parts(member)[-1])
            ]
            if len(archive.infolist()) > MAX_MEMBERS:
                raise InputError(f"{path.name} holds more than {MAX_MEMBERS:,} files.")
            limit = Limits.of_environment().file_bytes
            for member in members:
                if member.file_size > limit:
                    raise InputError(
                        f"{_parts(member)[-1]} in {path.name} would unpack to "
                        f"{member.file_size / 1e6:,.0f} MB; up to {limit / 1e6:,.0f} MB "
                        "are read. Reduce it, or raise the limit (SECURITY.md names its "
                        "variable)."
                    )
            size = sum(member.file_size for member in members)
            if size > TOGETHER * limit:
                raise InputError(
                    f"{path.name} would unpack to {size / 1e6:,.1f} MB; up to "
                    f"{TOGETHER * limit / 1e6:,.0f} MB are unpacked. Give its files "
                    "instead."
                )
            for member in {member.filename: member for member in members}.values():
                unpacked.append(_unpacked(archive, member, path, folder))
    except DAMAGE as error:
        raise InputError(
            f"{path.name} could not be unpacked: it is damaged, or not a zip."
        ) from error
    except (RuntimeError, NotImplementedError) as error:
        raise InputError(
            f"{path.name} is encrypted, or packed in a way that photoreg does not know. "
            "Unpack it and give its files."
        ) from error
    except OSError as error:
        raise OutputError(
            f"{path.name} could not be unpacked: {error.strerror or error}."
        ) from error
    return unpacked


def _unpacked(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, path: Path, folder: Path
) -> Path:
    """Writes one file of the zip at ``path``; returns where it is."""
    parts = _parts(member)
    target = folder.joinpath(*parts)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # Never more bytes than announced: zipfile stops there.
        with archive.open(member) as source, target.open("wb") as file:
            shutil.copyfileobj(source, file, 1 << 20)
    except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        raise InputError(
            f"{path.name} could not be unpacked: in it one name is a file's and a "
            f"folder's at once ({'/'.join(parts)}). Give its files instead."
        ) from error
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise InputError(
            f"{path.name} could not be unpacked: in it is a name longer than the disk "
            f"allows ({max(parts, key=len)[:40]}…). Rename it, or give its files instead."
        ) from error
    return target


def _parts(member: zipfile.ZipInfo) -> list[str]:
    """Folders and name, none of which leads elsewhere."""
    parts = member.filename.replace("\\", "/").replace(":", "_").split("/")
    return [part for part in parts if part not in ("", ".", "..")] or ["file"]
