"""Who may write a project: one program at a time, whatever becomes of the lock's file."""

import contextlib
import datetime
import os
import re
import socket
import sys
from pathlib import Path

from photoreg.errors import InputError
from photoreg.project.folder import LOCK, identity, is_file, look
from photoreg.sources import open_for_reading, open_regular

OURS = re.compile(rb"process \d+ on ")
MAX_BYTES = 300


class FolderLock:
    """Held by the one program that may write a project; ends with its process.

    Two locks are one: of the file `project.lock`, which also tells who holds it, and of
    the folder itself, which no removal of that file undoes.

    The package filelock (4.3.1, tried) is not enough: it does not lock folders, so when
    the lock file is removed or replaced two programs hold it and neither notices, and it
    accepts a hard link to somebody else's file.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / LOCK
        self._folder_handle: int | None = None
        self._handle: int | None = None

    def take(self) -> bool:
        """Tries to take it; returns whether that worked.

        Raises:
            InputError: if what has the lock's name is not photoreg's.
            OSError: if the folder cannot be written.
        """
        if not self._take_folder():
            return False
        try:
            taken = self._take_file()
        except BaseException:
            self.release()
            raise
        if not taken:
            self.release()
        return taken

    def is_held(self) -> bool:
        """Whether it is held still; a lock's file that was removed is made again."""
        if self._handle is None:
            return False
        found = look(self._path)
        if found is not None:
            return identity(found) == identity(os.fstat(self._handle))
        try:
            return self._take_file()
        except (InputError, OSError):
            return False

    @property
    def holder(self) -> str:
        """Who holds it, as far as is known."""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            with open_for_reading(self._path, follow_link=False) as file:
                text = file.read(MAX_BYTES)
            return text.decode().strip() if OURS.match(text) else ""
        return ""

    def open_inside(self, path: Path) -> int | None:
        """Opens a file of the folder, wherever that is now; None: not possible here.

        Raises:
            OSError: if it cannot be opened, or is a link, a pipe or a device.
        """
        if self._folder_handle is None or os.open not in os.supports_dir_fd:
            return None
        return open_regular(path, follow_link=False, inside=self._folder_handle)

    def remove(self) -> None:
        """Ends it, and removes its file: for a folder that goes as a whole."""
        if os.name == "nt":
            self.release()
        with contextlib.suppress(OSError):
            self._path.unlink()
        self.release()

    def release(self) -> None:
        """Lets others have it. The file stays: removing it would let two in."""
        for handle in (self._handle, self._folder_handle):
            if handle is not None:
                os.close(handle)
        self._handle = self._folder_handle = None

    def _take_folder(self) -> bool:
        if os.name != "posix":
            return True  # There nobody can remove a file that is open.
        handle = os.open(self._folder, os.O_RDONLY)
        try:
            taken = _lock(handle)
        except OSError:
            # Some file systems lock no folders; the file's lock is what is left.
            os.close(handle)
            return True
        if taken:
            self._folder_handle = handle
        else:
            os.close(handle)
        return taken

    def _take_file(self) -> bool:
        found = look(self._path)
        if found is not None and (not is_file(found) or found.st_nlink > 1):
            raise self._foreign()
        flags = os.O_RDWR | os.O_CREAT
        handle = open_regular(self._path, flags, follow_link=False)
        try:
            taken = _lock(handle)
            now = look(self._path)
            if now is None or identity(now) != identity(os.fstat(handle)):
                taken = False  # Somebody has put another in its place meanwhile.
            if not taken:
                os.close(handle)
                return False
            os.lseek(handle, 0, os.SEEK_SET)
            text = os.read(handle, MAX_BYTES)
            if text and not OURS.match(text):
                raise self._foreign()
        except BaseException:
            with contextlib.suppress(OSError):
                os.close(handle)
            raise
        since = f"{datetime.datetime.now():%Y-%m-%d %H:%M}"
        told = f"process {os.getpid()} on {socket.gethostname()} since {since}\n"
        os.ftruncate(handle, 0)
        os.lseek(handle, 0, os.SEEK_SET)
        os.write(handle, told.encode())
        if self._handle is not None:
            os.close(self._handle)
        self._handle = handle
        return True

    def _foreign(self) -> InputError:
        return InputError(
            f"{self._path} is not photoreg's: it should be a small file that tells who "
            "has the project open, and is a link or something else. Move it away, then "
            "open the project."
        )


if sys.platform == "win32":
    import msvcrt

    def _lock(handle: int) -> bool:
        # Far behind the text, which others may read.
        os.lseek(handle, 1 << 30, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _lock(handle: int) -> bool:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True


NETWORK_FILE_SYSTEMS = """
9p afpfs afs beegfs ceph cifs coda davfs fuse.ceph fuse.davfs2 fuse.glusterfs fuse.rclone
fuse.s3fs fuse.smbnetfs fuse.sshfs gfs2 glusterfs lustre ncpfs nfs nfs4 ocfs2 panfs smb2
smb3 smbfs vboxsf
"""


def is_on_network(folder: Path, mounts: Path = Path("/proc/self/mountinfo")) -> bool:
    """Whether other machines may have the folder too, as far as the system tells.

    Args:
        folder: The folder.
        mounts: Linux's list of what is mounted where.
    """
    resolved = folder.resolve()
    if sys.platform == "win32":
        import ctypes  # noqa: PLC0415

        remote = ctypes.windll.kernel32.GetDriveTypeW(resolved.anchor) == 4
        return remote or resolved.anchor.startswith("\\\\")
    try:
        lines = mounts.read_text("utf-8", "replace").splitlines()
    except OSError:
        return False
    kind, longest = "", -1
    for line in lines:
        before, _, after = line.partition(" - ")
        place = before.split()[4].encode().decode("unicode_escape")
        if resolved.is_relative_to(place) and len(place) >= longest:
            kind, longest = after.split()[0], len(place)
    return kind in NETWORK_FILE_SYSTEMS.split()
