"""Opening files: regular ones only, and a fingerprint of their content.

A pipe, a device or a socket in the place of a file would block whoever opens it, or never
end. So everything that photoreg reads is opened here.
"""

import contextlib
import dataclasses
import errno
import hashlib
import io
import os
import stat
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFLNK: "a link",
}


@dataclasses.dataclass(frozen=True)
class SourceFile:
    """A file as it was when it was read."""

    path: Path
    """Absolute path."""
    sha256: str
    """SHA-256 of its content, hexadecimal: tells a changed file from a moved one."""
    size: int
    """Size in bytes."""


def open_regular(
    path: Path | str,
    flags: int = os.O_RDONLY,
    *,
    follow_link: bool,
    inside: int | None = None,
) -> int:
    """Opens or makes a regular file; never waits for anybody.

    Args:
        path: Where it is.
        flags: As of `os.open`.
        follow_link: Whether it may be a link to a file.
        inside: Handle of the folder that a relative path begins at.

    Returns:
        Its handle.

    Raises:
        OSError: if it cannot be opened, or is not a file; says in words what it is.
    """
    # Before it is opened: opening some devices does something already.
    with contextlib.suppress(FileNotFoundError):
        found = os.stat(path, dir_fd=inside, follow_symlinks=follow_link)
        _check_regular(path, found)
    for name in ("O_BINARY", "O_NOCTTY", "O_NONBLOCK"):
        flags |= getattr(os, name, 0)  # Windows knows the first, Unix the others.
    if not follow_link:
        flags |= getattr(os, "O_NOFOLLOW", 0)
    handle = os.open(path, flags, 0o666, dir_fd=inside)
    try:
        _check_regular(path, os.fstat(handle))  # It may be another one by now.
    except BaseException:
        os.close(handle)
        raise
    return handle


def open_for_reading(path: Path, *, follow_link: bool = True) -> io.BufferedReader:
    """Opens a file to be read; never waits for anybody.

    Args:
        path: The file.
        follow_link: Whether it may be a link to a file.

    Raises:
        OSError: if it cannot be opened, or is not a file; says in words what it is.
    """
    return os.fdopen(open_regular(path, follow_link=follow_link), "rb")


def read_regular(path: Path, *, follow_link: bool = True) -> bytes:
    """The whole content of a file; see ``open_for_reading``."""
    with open_for_reading(path, follow_link=follow_link) as file:
        return file.read()


def source_file(path: Path) -> SourceFile:
    """The file at ``path`` as it is now; reads all of it (about 1 GB/s)."""
    with open_for_reading(path) as file:
        size = os.fstat(file.fileno()).st_size
        digest = hashlib.sha256()
        left = size
        while chunk := file.read(min(left, 1 << 20) + 1):
            left -= len(chunk)
            if left < 0:
                # It grows, or it is one of the system's that have no size and no end.
                raise OSError(errno.EFBIG, "it is longer than its size", str(path))
            digest.update(chunk)
    return SourceFile(path.absolute(), digest.hexdigest(), size)


def _check_regular(path: Path | str, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
