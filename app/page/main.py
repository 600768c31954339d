"""Starts the app and keeps it running until Ctrl-C."""

import contextlib
import logging
import os
import shlex
import signal
import sys
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from app.control.controller import Controller
from app.control.projects import Projects
from app.engine.scene_opening import demo_folder, open_files, open_folder
from app.model.scene_files import photo_files, with_cameras_of_file
from app.model.session import Session
from app.model.state import Document
from app.page.server import Page
from app.web.access import AccessControl
from photoreg.batch.mended import opened_files, project_folder
from photoreg.batch.record import is_known
from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.registry import read_cameras
from photoreg.project.folder import FolderInUseError, check_is_free, holds_project
from photoreg.registration.world import in_world_of_mesh


def run_app(
    files: Sequence[Path] = (),
    cameras: Path | None = None,
    *,
    project: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    address: str | None = None,
    open_browser: bool = True,
    shadows: bool = True,
    surroundings: bool = True,
) -> int:
    """Serves the app until it is interrupted; returns the exit status.

    Args:
        files: A mesh and photos, or one folder with both; empty for the demo.
        cameras: Cameras of the photos, a photoreg camera file.
        project: Folder of the project: opened where it is one, made where not; None:
            a new one in the user's data folder.
        host: Address to listen on.
        port: Port to listen on; the next free one is taken when it is busy.
        token: What lets a browser in; None: the environment variable PHOTOREG_TOKEN, or,
            where other machines can reach the port, one that is made.
        address: Where people reach it through a proxy, "https://photos.example.org".
        open_browser: Whether to open the page, where there is a browser.
        shadows: Whether the scene is drawn with shadows; they cost a slow browser much.
        surroundings: Whether a picture of surroundings lights the scene, too; without
            a graphics card it costs ten seconds at first and half the speed.

    Raises:
        InputError: if a file is missing or not valid.
    """
    token = token or os.environ.get("PHOTOREG_TOKEN")
    access = AccessControl.with_a_token(host, token, address)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    session = Session()
    projects = Projects(session)
    controller = page = None
    try:
        open_project(projects, files, cameras, project)
        controller = Controller(session, projects=projects)
        page = Page(session, controller, access, port, shadows, surroundings)
        if page.port != port and port != 0:
            _say(f"Port {port} is taken, so photoreg uses {page.port}.")
        # A token that was given is known to who gave it, and stays out of logs.
        shown = access.entrance(page.port, with_token=not token)
        _say(f"photoreg is at {shown} (Ctrl-C ends it).")
        if access.token is not None:
            _say(
                "Whoever has this address may come in."
                if not token
                else "It asks for your token once in each browser; /?token=... gives it."
            )
        if open_browser and has_browser():
            webbrowser.open(access.entrance(page.port))
        _wait_for_the_end()
    finally:
        if page is not None:
            page.close()
        if controller is not None:
            controller.close()
        projects.close()
    _say("Stopped.")
    return 0


def open_project(
    projects: Projects,
    files: Sequence[Path],
    cameras: Path | None,
    folder: Path | None,
) -> None:
    """Opens a project as it was left, or begins one with files or the demo.

    Raises:
        InputError: if the project or a file cannot be used as it is.
        OutputError: if the named folder cannot be written.
    """
    if len(files) == 1 and is_known(files[0]):
        if folder is not None or cameras is not None:
            raise InputError(
                f"{files[0]} is an object of a batch, which has its own cameras and its "
                "own project. Open it without others."
            )
        files, cameras, folder = _object_of_batch(files[0])
    if folder is not None and holds_project(folder):
        if files or cameras is not None:
            raise InputError(
                f"{folder} holds a project already. Open it without other files, or "
                "name another folder for them."
            )
        waiting = projects.open(folder)
        if waiting is not None:
            sentences = " ".join(problem.sentence for problem in waiting.problems)
            _say(f"{sentences} The page asks what to do.")
            projects.begin_unkept(Document())
    else:
        if folder is not None:
            _check_folder(folder, files, cameras)
        document = open_document(files, cameras)
        try:
            projects.new(document, folder)
        except OutputError as error:
            if folder is not None:
                raise
            _say(f"{error} Nothing will be kept when photoreg ends.")
            projects.begin_unkept(document)
            return
    if projects.current is not None:
        kept = projects.current
        _say(kept.read_only or f"Your work is kept in {kept.folder}.")


def _object_of_batch(folder: Path) -> tuple[list[Path], Path | None, Path]:
    """Files, cameras and project of an object; a project that is there has the others."""
    project = project_folder(folder)
    if holds_project(project):
        return [], None, project
    files, cameras = opened_files(folder)
    return files, cameras, project


def _check_folder(folder: Path, files: Sequence[Path], cameras: Path | None) -> None:
    """Refuses a folder that holds other things, with a command that can be used."""
    try:
        check_is_free(folder)
    except FolderInUseError as error:
        words = ["photoreg", "app", *map(str, files)]
        words += [] if cameras is None else ["--cameras", str(cameras)]
        words += ["--project", str(error.suggestion)]
        raise InputError(
            f"{folder} holds other files and no project. A project is begun in a new or "
            f"an empty folder, so that nothing of yours is touched. Use: "
            f"{shlex.join(words)}"
        ) from error


def open_document(files: Sequence[Path], cameras: Path | None) -> Document:
    """What to open: the demo, a folder, or a mesh with photos."""
    if not files:
        document = open_folder(demo_folder())
    elif len(files) == 1 and Path(files[0]).is_dir():
        document = open_folder(Path(files[0]))
    else:
        document = open_files([Path(file) for file in files])
    if document.mesh is not None:
        for note in document.mesh.notes:
            _say(f"Note: {document.mesh.name}: {note}")
    if cameras is None:
        return document
    file = read_cameras(cameras, photos=photo_files(document))
    if document.mesh is not None:
        # Here no other thread runs numba's kernels yet.
        photos = [entry.photo for entry in document.photos]
        file = in_world_of_mesh(document.mesh, photos, file)
    for note in file.notes:
        _say(f"Note: {note}")
    return with_cameras_of_file(document, file, cameras.name)


def has_browser() -> bool:
    """Whether a browser with a screen can be expected here."""
    if sys.platform.startswith("linux"):
        shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        if not shown:
            return False
    try:
        webbrowser.get()
    except webbrowser.Error:
        return False
    return True


def _wait_for_the_end() -> None:
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        # Said explicitly: a shell starts background programs deaf to Ctrl-C.
        signal.signal(number, lambda *_: ended.set())
    # The terminal was shut; under nohup that means nothing.
    hang_up = getattr(signal, "SIGHUP", None)
    if hang_up is not None and signal.getsignal(hang_up) is not signal.SIG_IGN:
        signal.signal(hang_up, lambda *_: ended.set())
    # In steps: on Windows a wait without end is not interrupted.
    while not ended.wait(0.5):
        pass


def _say(text: str) -> None:
    with contextlib.suppress(OSError):  # The terminal may have gone.
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
