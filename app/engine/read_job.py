"""Files read in a process of their own, which Cancel simply ends.

Neither Pillow nor trimesh can be interrupted within a file, nor can libyaml. The worker cannot be ended
for it: it holds the scene and its compiled kernels, and may be at work.
"""

import contextlib
import dataclasses
import logging
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from app.engine.file_kinds import (
    CAMERAS,
    MATERIAL,
    MESH,
    PHOTO,
    UNREAD,
    is_zip,
    kind_of,
)
from app.engine.spawn import PATIENCE_S, spawned
from app.model.messages import (
    CamerasLoaded,
    Failed,
    MeshLoaded,
    PhotoLoaded,
    ReadAll,
    Reading,
    ReadingEvent,
    Unpacked,
)
from app.model.scene_files import DISPLAY_FACES, first_names
from photoreg.errors import PhotoregError
from photoreg.formats.archives import unzipped
from photoreg.formats.cameras.cameras_json import CameraFile
from photoreg.formats.cameras.find import find_camera_file
from photoreg.formats.cameras.meshlab import PADDED
from photoreg.formats.cameras.registry import format_to_read, read_cameras
from photoreg.formats.foreign import what_to_do
from photoreg.formats.meshes.packed import PACKED_SUFFIX, belonging, pack
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.registration.world import in_world_of_mesh

log = logging.getLogger(__name__)

PARSED = 0.6
"""Share of a mesh's time after which its file is read; the rest thins it for display."""

MAX_TOLD = 5
"""At most so many left-out files of a zip are named."""

OF_SYSTEMS = ("thumbs.db", "desktop.ini")
"""What Windows puts beside files, in lower case; macOS's and Linux's begin with a dot."""


@dataclasses.dataclass(frozen=True)
class ReadRequest:
    """What is read together."""

    paths: tuple[Path, ...]
    """Meshes and photos."""
    cameras: Path | None
    """A folder with the files of one set of cameras; read after the others."""
    photos: Mapping[str, Path]
    """Photos by name, to which cameras may belong."""
    mesh: Path | None = None
    """The mesh that is open, which the cameras are to look at unless another is read."""


@dataclasses.dataclass(frozen=True)
class UnpackRequest:
    """Zips, out of which come cameras, and the mesh and photos that are not there.

    A mesh becomes one file with the materials and pictures that it names, whether they
    came in a zip or beside one; these pictures are no photos.
    """

    loose: tuple[Path, ...]
    """Files that came beside the zips."""
    archives: tuple[Path, ...]
    folder: Path
    """Where they go."""
    known: frozenset[str]
    """Names of photos that are there."""
    has_mesh: bool

    def wants(self, name: str) -> bool:
        """Whether a file comes out of its zip."""
        if name.startswith("."):
            return False  # What systems put beside files: macOS's ._photo.jpg.
        kind = kind_of(Path(name))
        if kind == PHOTO:
            # MeshLab's padded copies are of photos that have another name.
            return name not in self.known and PADDED.fullmatch(name) is None
        # A mesh also where there is one: pictures that it names are no photos.
        return kind in (MESH, MATERIAL) or (kind == CAMERAS and not is_zip(Path(name)))


class Reader:
    """Reads one batch of files at a time. Events arrive on a thread of this object."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: BaseProcess | None = None
        self._connection: Connection | None = None

    def prepare(self) -> None:
        """Starts the process, which takes a second; files may still be on their way."""
        with self._lock:
            self._start()

    def read(
        self,
        wanted: ReadRequest | UnpackRequest,
        on_event: Callable[[ReadingEvent], None],
    ) -> None:
        """Starts to read or unpack; returns at once. The last event is ``ReadAll``.

        After ``cancel`` some events may still come that were on their way.
        """
        with self._lock:
            process, connection = self._start()
        threading.Thread(
            target=_pump,
            args=(process, connection, wanted, on_event),
            daemon=True,
            name="reader",
        ).start()

    def cancel(self) -> None:
        """Ends the process, whatever it is about."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.join(timeout=PATIENCE_S)

    def _start(self) -> tuple[BaseProcess, Connection]:
        process, connection = self._process, self._connection
        if process is None or connection is None or not process.is_alive():
            process, connection = spawned(_serve)
            self._process, self._connection = process, connection
        return process, connection


def _pump(
    process: BaseProcess,
    connection: Connection,
    wanted: ReadRequest | UnpackRequest,
    on_event: Callable[[ReadingEvent], None],
) -> None:
    at = ""
    try:
        connection.send(wanted)
        while True:
            event: ReadingEvent = connection.recv()
            if isinstance(event, Reading):
                at = f" ({event.title})"
            on_event(event)
            if isinstance(event, ReadAll):
                return
    except (EOFError, OSError):
        process.join(timeout=PATIENCE_S)
        text = (
            f"Reading was cut short{at}: the decoder failed, or there is too little "
            "memory. Save that file anew, or in another format."
        )
        on_event(Failed("read", text))
        on_event(ReadAll(complete=False))
    except Exception:
        log.exception("A file that was read was not handled")
        on_event(Failed("read", "Opening failed; the log has the details."))
        on_event(ReadAll(complete=False))


def _serve(connection: Connection) -> None:
    try:
        while True:
            wanted = connection.recv()
            unpacks = isinstance(wanted, UnpackRequest)
            for event in _unpack(wanted) if unpacks else _read(wanted):
                connection.send(event)
    except (EOFError, OSError):
        return  # The app is gone.


def _read(wanted: ReadRequest) -> Iterator[ReadingEvent]:
    places = [*wanted.paths, *([wanted.cameras] if wanted.cameras else [])]
    sizes = [max(_size(place), 1) for place in places]
    for i, place in enumerate(places):
        name = "the cameras" if place == wanted.cameras else place.name
        of = f" ({i + 1} of {len(places)})" if len(places) > 1 else ""
        done, share = sum(sizes[:i]) / sum(sizes), sizes[i] / sum(sizes)
        yield Reading(f"Reading {name}{of}", done)
        with _failures(f"Reading {name}") as failures:
            if place == wanted.cameras:
                path = find_camera_file(place)
                told = path.name if path.is_file() else format_to_read(path).label
                file = read_cameras(path, photos=wanted.photos)
                if file.moved is not None:
                    file = _in_world_of_mesh(wanted, file)
                yield CamerasLoaded(told, file)
            elif kind_of(place) == MESH:
                mesh = load_mesh(place)
                title = f"Preparing {name} for display{of}"
                yield Reading(title, done + PARSED * share)
                yield MeshLoaded(mesh, mesh.decimated(DISPLAY_FACES))
            else:
                yield PhotoLoaded(load_photo(place))
        yield from failures
    yield ReadAll(complete=True)


def _in_world_of_mesh(wanted: ReadRequest, file: CameraFile) -> CameraFile:
    meshes = [path for path in wanted.paths if kind_of(path) == MESH]
    place = meshes[0] if meshes else wanted.mesh
    if place is None:
        return file
    photos = [
        dataclasses.replace(load_photo(path), name=name)
        for name, path in wanted.photos.items()
        if file.of_photo(name) is not None
    ]
    return in_world_of_mesh(load_mesh(place), photos, file)


def _unpack(packed: UnpackRequest) -> Iterator[ReadingEvent]:
    found = list(packed.loose)
    left_out: list[str] = []
    unread: list[str] = []

    def wants(name: str) -> bool:
        path = Path(name)
        if not (name.startswith(".") or name.casefold() in OF_SYSTEMS):
            why = what_to_do(path)
            if why and len(left_out) < MAX_TOLD:
                left_out.append(f"{name} was left out: {why}.")
            elif why or kind_of(path) == UNREAD or is_zip(path):
                unread.append(name)
        return packed.wants(name)

    for i, archive in enumerate(packed.archives):
        yield Reading(f"Unpacking {archive.name}", i / len(packed.archives))
        folder = packed.folder / archive.stem
        with _failures(f"Unpacking {archive.name}") as failures:
            found += unzipped(archive, folder, wants)
            archive.unlink()
        yield from failures
    with _failures("Reading the mesh") as failures:
        wanted = packed.loose if packed.has_mesh else tuple(found)
        paths = _packed_together(found, wanted, packed.folder)
        if unread:
            names = first_names(unread, MAX_TOLD)
            left_out.append(f"Left out, as photoreg opens no such files: {names}.")
        yield Unpacked(tuple(paths), tuple(left_out))
    yield from failures
    yield ReadAll(complete=True)


def _packed_together(
    paths: list[Path], wanted: tuple[Path, ...], folder: Path
) -> list[Path]:
    """The files, each mesh as one with those among them that it names.

    Meshes that are not ``wanted`` go, with what belongs to them.
    """
    for mesh in [path for path in paths if kind_of(path) == MESH]:
        others = [path for path in paths if kind_of(path) in (PHOTO, MATERIAL)]
        beside = belonging(mesh, others)
        if mesh not in wanted:
            paths = [path for path in paths if path not in (mesh, *beside)]
        elif beside:
            target = folder / "packed" / f"{mesh.name}{PACKED_SUFFIX}"
            target.parent.mkdir(exist_ok=True)
            pack(mesh, beside, target)
            paths = [path for path in paths if path not in (mesh, *beside)] + [target]
    return paths


@contextlib.contextmanager
def _failures(what: str) -> Iterator[list[Failed]]:
    """Catches what goes wrong with one file; the list has it afterwards."""
    failures: list[Failed] = []
    try:
        yield failures
    except PhotoregError as error:
        failures.append(Failed("read", str(error)))
    except MemoryError:
        failures.append(Failed("read", f"{what} takes more memory than there is."))
    except Exception:  # noqa: BLE001 - the border of the process: report.
        text = f"{what} crashed; the log has the details."
        failures.append(Failed("read", text, traceback.format_exc()))


def _size(place: Path) -> int:
    """Bytes of a file, or of all that is in a folder."""
    files = place.rglob("*") if place.is_dir() else [place]
    return sum(path.stat().st_size for path in files)
