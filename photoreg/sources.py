"""Opening what is read: regular files only, and a fingerprint of their content.

A pipe, a device or a socket in the place of a file would block whoever opens it, or never
end. So everything that photoreg reads is opened here.
"""

import dataclasses
import errno
import hashlib
import os
import stat
from pathlib import Path
from typing import IO

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


def open_for_reading(path: Path, *, follow_link: bool = True) -> IO[bytes]:
    """Opens a file to be read; never waits for anybody.

    Args:
        path: The file.
        follow_link: Whether it may be a link to a file.

    Raises:
        OSError: if it cannot be opened, or is not a file; says in words what it is.
    """
    # Before it is opened: opening some devices does something already.
    _check_regular(path, path.stat() if follow_link else path.lstat())
    flags = os.O_RDONLY
    for name in ("O_BINARY", "O_CLOEXEC", "O_NOCTTY", "O_NONBLOCK"):
        flags |= getattr(os, name, 0)  # Windows knows the first, Unix the others.
    if not follow_link:
        flags |= getattr(os, "O_NOFOLLOW", 0)
    file = os.open(path, flags)
    try:
        _check_regular(path, os.fstat(file))  # It may be another one by now.
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


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


def _check_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
