"""Kills server and worker at random moments during work, and looks for what is lost.

`make crash`, or `python -m tests.robustness.crash --kills 200 --seed 1` once the kernels are
compiled (`python -m tests.compile_kernels`): a worker that is killed each time never comes
to keep its own. Each life of the server
is a process of its own, with a page, a worker and a project. It goes on with the work
where the project was left, and tells what it has done and what the page shows as done.
Then the worker, and after it the server, get SIGKILL. What the project holds afterwards
must be at least what the page has shown, and be whole. In every folder that it uses lie
files, links and pipes of somebody's own, which must be as they were after each kill.
"""

import argparse
import contextlib
import dataclasses
import hashlib
import json
import os
import random
import selectors
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np

from app.control.autosave import DOCUMENT_TYPES, Autosave
from app.control.controller import Controller
from app.control.projects import Projects
from app.model.session import (
    Session,
    select,
    setting,
    with_entry,
    with_photo_added,
    with_photo_removed,
)
from app.model.state import PointPair, State
from app.page.main import open_project
from app.page.server import Page
from photoreg.errors import PhotoregError
from photoreg.formats.photos.read import load_photo
from photoreg.project.project import Project
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene, write_scene
from tests.robustness.test_foreign_files import imprint

MAX_LIFE_S = 1.5
"""The kills come within this time after the server serves."""

RUN_EVERY = 4
"""One life in so many has a refinement under way."""

TELL_EVERY = 10
"""Lives after which the figures so far are printed."""

N_BACK = 50
"""Steps back that are compared."""

START_S, TOLD_S = 600.0, 300.0
"""How long something may take that comes for certain, on a busy machine too."""

FOREIGN = (
    "thesis.txt",
    f".photoreg-{'0' * 32}.part",
    "link.png",
    "link",
    "pipe",
    "mine",
)
"""What somebody else puts into each folder."""


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit status: 1 if anything was lost."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness.crash")
    parser.add_argument("--kills", type=int, default=200, help="both kinds together")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args(arguments)
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="photoreg-crash-") as name:
        os.environ["PHOTOREG_DATA"] = f"{name}/data"
        world = Path(name) / "scene"
        options = SceneOptions(kind="clean", width=160, height=120, error_px=(3.0, 4.0))
        write_scene(make_scene(options), world)
        crash = Crash(Path(name) / "work", world, chosen.seed)
        # Ctrl-C ends it with the figures so far.
        with contextlib.suppress(KeyboardInterrupt):
            while crash.n_server_kills + crash.n_worker_kills < chosen.kills:
                crash.one_life()
                if crash.n_server_kills % TELL_EVERY == 0:
                    print(crash.summary(time.monotonic() - began), flush=True)
    print(crash.summary(time.monotonic() - began), flush=True)
    return 1 if crash.lost else 0


class Crash:
    """The one who kills, and looks afterwards."""

    def __init__(self, folder: Path, world: Path, seed: int) -> None:
        self._folder, self._world = folder, world
        self._random = random.Random(seed)
        self._done: dict[int, str] = {}
        self.n_server_kills = self.n_worker_kills = self.n_in_run = 0
        self.n_steps = self.n_shown = 0
        self.n_runs = self.n_runs_resumable = self.n_runs_ended = 0
        self.lost: list[str] = []
        self._foreign: dict[Path, tuple[int, str]] = {}

    def _put_foreign(self) -> None:
        """Puts somebody's own files into all folders that are there and lack them."""
        work, data = self._folder, Path(os.environ["PHOTOREG_DATA"])
        outside = work.with_name("outside")
        outside.mkdir(exist_ok=True)
        (outside / "seen again.png").write_bytes(b"mine")
        folders = [work, work / "files", *sorted((work / "files").glob("[0-9]/"))]
        for folder in (*folders, self._world, data, data / "projects", outside):
            if folder.is_dir() and folder / "thesis.txt" not in self._foreign:
                (folder / "thesis.txt").write_bytes(b"five years of work")
                (folder / f".photoreg-{'0' * 32}.part").write_bytes(b"partly mine")
                (folder / "link.png").symlink_to(outside / "seen again.png")
                (folder / "link").symlink_to(outside)
                os.mkfifo(folder / "pipe")
                (folder / "mine").mkdir()
                (folder / "mine" / "seen again.png").write_bytes(b"mine, too")
                for path in (*folder.iterdir(), *(folder / "mine").iterdir()):
                    if path.name in FOREIGN or path.parent.name == "mine":
                        self._foreign[path] = imprint(path)

    def _look_for_foreign(self) -> None:
        for path, before in self._foreign.items():
            if not os.path.lexists(path) or imprint(path) != before:
                self.lost.append(f"life {self.n_server_kills}: {path} of somebody else")

    def one_life(self) -> None:
        """Starts a server, kills its worker, then itself, and looks."""
        number = self.n_server_kills
        has_run = number % RUN_EVERY == RUN_EVERY - 1
        read, write = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(read)
            live(self._folder, self._world, os.fdopen(write, "w"), number, has_run)
        os.close(write)
        with os.fdopen(read, "r") as told:
            lines = Lines(told)
            try:
                self._wait_and_kill(lines, has_run)
            finally:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
            lines.rest()
        self.n_server_kills += 1
        self._look_for_foreign()
        self._look(lines.whole, has_run)
        self._put_foreign()

    def _wait_and_kill(self, lines: "Lines", has_run: bool) -> None:
        """Kills the worker, and waits for the moment to kill the server ``pid``."""
        worker = int(lines.until("ready", START_S).split()[1])
        if has_run:
            lines.until("course", START_S)
        # One, the other, or both at the same moment: in any order of events.
        time.sleep(self._random.uniform(0.0, MAX_LIFE_S) / 2)
        os.kill(worker, signal.SIGKILL)
        self.n_worker_kills += 1
        if has_run and self._random.random() < 0.5:
            lines.until("no run", TOLD_S)
        time.sleep(self._random.uniform(0.0, MAX_LIFE_S) / 2)

    def _look(self, lines: list[str], has_run: bool) -> None:
        shown = at_least = None
        for line in lines:
            kind, *rest = line.split(maxsplit=2)
            if kind == "done":
                self._done[int(rest[0])] = rest[1]
                self.n_steps += 1
            elif kind == "shown":
                at_least, shown = int(rest[0]), json.loads(rest[1])
                self.n_shown += 1
            elif kind == "failed":
                self.lost.append(f"life {self.n_server_kills}: {line}")
        try:
            session = Session()
            project = Project(self._folder, DOCUMENT_TYPES, create=False)
            try:
                if project.read_only:
                    raise AssertionError(f"still locked: {project.read_only}")
                show = Autosave(session, project).take_up()
                if show is None:
                    raise AssertionError("empty")
                show()
            finally:
                project.close()
        except (PhotoregError, AssertionError) as error:
            self.lost.append(f"life {self.n_server_kills}: cannot be opened: {error}")
            return
        state, n = session.state, count(session.state)
        self.n_in_run += has_run
        if has_run and shown is not None and shown["under_way"]:
            self._look_for_run(state, shown["under_way"])
        if at_least is not None and n < at_least:
            self.lost.append(
                f"life {self.n_server_kills}: step {at_least} was shown, {n} is kept"
            )
        if n in self._done and fingerprint(session) != self._done[n]:
            self.lost.append(f"life {self.n_server_kills}: step {n} is not as it was")
        runs = [run.number for run in state.runs]
        gone = set(shown["runs"]) - set(runs) if shown is not None else set()
        if gone:
            self.lost.append(
                f"life {self.n_server_kills}: runs {sorted(gone)} are gone"
            )

    def _look_for_run(self, state: State, number: int) -> None:
        """A run that was shown at work can go on, if it has not come to its end."""
        can_go_on = state.can_go_on and state.run.number == number
        has_ended = any(
            run.number == number and run.start_cost is not None for run in state.runs
        )
        self.n_runs += 1
        self.n_runs_resumable += can_go_on
        self.n_runs_ended += has_ended
        if not can_go_on and not has_ended:
            self.lost.append(
                f"life {self.n_server_kills}: run {number} cannot go on, it is "
                f"{state.run.status}"
            )

    def summary(self, seconds: float) -> str:
        """What was done and found, in a few lines."""
        lines = [
            f"{self.n_server_kills} kills of the server and {self.n_worker_kills} of the "
            f"worker in {seconds / 60:.1f} min; {self.n_in_run} servers had a refinement "
            f"under way.",
            f"{self.n_steps} steps done, {self.n_shown} states shown; of {self.n_runs} "
            f"refinements that were shown at work {self.n_runs_resumable} could go on "
            f"where they were and {self.n_runs_ended} had come to their end.",
            f"{len(self._foreign)} files of somebody else lie in the folders.",
            f"Lost: {len(self.lost)}.",
            *self.lost,
        ]
        return "\n".join(lines)


class Lines:
    """What a server tells, whole lines only."""

    def __init__(self, told: IO[str]) -> None:
        self._told = told
        self._selector = selectors.DefaultSelector()
        self._selector.register(told, selectors.EVENT_READ)
        self._pending = b""
        self.whole: list[str] = []

    def until(self, word: str, timeout_s: float) -> str:
        """Reads until a line begins with ``word``; returns it."""
        deadline, seen = time.monotonic() + timeout_s, len(self.whole)
        while True:
            for line in self.whole[seen:]:
                if line.startswith(word):
                    return line
            seen = len(self.whole)
            if time.monotonic() > deadline:
                raise AssertionError(f"In vain: {word}; the last: {self.whole[-3:]}")
            if self._selector.select(1.0) and not self._read():
                raise AssertionError(f"The server ended by itself: {self.whole[-3:]}")

    def rest(self) -> None:
        """Reads what is left after its end."""
        while self._read():
            pass

    def _read(self) -> bool:
        more = os.read(self._told.fileno(), 1 << 16)
        *whole, self._pending = (self._pending + more).split(b"\n")
        self.whole += [line.decode() for line in whole]
        return bool(more)


# In the server's process.


class Witness:
    """A panel that tells what the page shows at the moment it shows it."""

    def __init__(self, page: Page, told: IO[str]) -> None:
        self._page, self._told = page, told

    def show(self, state: State) -> None:
        """Tells it, unless the page says that it is still being kept."""
        if "Keeping your work" in self._page._status.content:
            return
        run = state.run
        is_under_way = (run.is_active and bool(run.curve)) or state.can_go_on
        about = {
            "runs": [ended.number for ended in state.runs],
            "under_way": run.number if is_under_way else 0,
        }
        tell(self._told, f"shown {count(state)} {json.dumps(about)}")
        if state.run.curve and state.run.is_active:
            tell(self._told, "course")
        if not state.run.is_active:
            tell(self._told, "no run")


def live(folder: Path, world: Path, told: IO[str], number: int, has_run: bool) -> None:
    """One life of a server: works until it is killed."""
    try:
        session = Session()
        projects = Projects(session)
        files = () if (folder / "project.db").exists() else (world,)
        with Path(os.devnull).open("w") as nowhere:
            sys.stdout = nowhere
            open_project(projects, files, None, folder)
            controller = Controller(session, warm_up=False, projects=projects)
            page = Page(session, controller, port=0, shadows=False, surroundings=False)
            page._panels = (*page._panels, Witness(page, told))  # pyright: ignore[reportAttributeAccessIssue]
            page._wake.set()
            if has_run:
                if session.state.run.status == "review":
                    if session.state.can_go_on:
                        controller.refinement.go_on()
                    else:
                        controller.refinement.revert()
                if session.state.run.status == "idle":
                    session.change(None, setting(preset="thorough"))
                    controller.refinement.start()
            elif session.state.run.status == "review":
                controller.refinement.accept()
            tell(told, f"ready {controller.worker.pid}")
            for step in script(session, projects, folder, number):
                tell(told, f"done {step} {fingerprint(session)}")
    except BaseException as error:  # noqa: BLE001 - whatever it is, it is told.
        tell(told, f"failed {type(error).__name__}: {error}")
    finally:
        while True:
            time.sleep(60.0)


def script(
    session: Session, projects: Projects, folder: Path, number: int
) -> Iterator[int]:
    """Goes on working, as quickly as a drag or a hand does; yields the steps' numbers."""
    chance = random.Random(number)
    step = count(session.state)
    while True:
        time.sleep(chance.choice((0.0, 0.005, 0.05)))
        step += 1
        with session.lock:
            if session.state.run.status != "idle":
                session.change(None, counted(step))
                session.change(None, select(chance.randrange(2)))
            else:
                _work(session, projects, chance, step)
                session.change(None, counted(step))
            yield step


def _work(
    session: Session, projects: Projects, chance: random.Random, step: int
) -> None:
    document = session.state.document
    entry = document.photos[0]
    match chance.randrange(8):
        case 0:
            session.undo()
        case 1:
            session.redo()
        case 2:
            pair = PointPair(step, (0.1 * step, 0.0, 1.0), (step % 100, 5.0))
            pairs = (*entry.pairs[-20:], pair)
            session.change("Add a point", with_entry(0, pairs=pairs))
        case 3 if len(document.photos) < 5:
            # Another each time, and none so bare that a run would be refused.
            pixels = np.roll(entry.photo.pixels, step, axis=0)
            content = cv2.imencode(".png", pixels)[1].tobytes()
            path = projects.keep_file("seen again.png", content)
            assert path is not None
            photo = load_photo(path)
            session.change("Add a photo", with_photo_added(photo, entry.camera))
        case 4 if len(document.photos) > 2:
            session.change("Remove a photo", with_photo_removed(2))
        case _:
            moved = entry.camera.t_cam_world + chance.uniform(-1e-3, 1e-3)
            camera = dataclasses.replace(entry.camera, t_cam_world=moved)
            # Many in a row are one step, as in a drag.
            session.change("Move", with_entry(0, camera=camera), ("drag", step // 10))


def counted(step: int) -> Any:
    """Counts the steps in a choice of the page, which is kept with the rest."""
    return setting(mesh_opacity=float(step))


def count(state: State) -> int:
    """How many steps lead to a state."""
    return int(state.mesh_opacity) if state.mesh_opacity >= 1.0 else 0


def fingerprint(session: Session) -> str:
    """Of what undo and redo reach: names, cameras, points, photos.

    Not of all: after steps were taken back the project reaches further back than the
    program did, which forgets what lies more than 200 steps behind the newest.
    """
    with session.lock:
        steps, now = session.history()
    steps, now = steps[max(0, now - N_BACK) :], min(now, N_BACK)
    digest = hashlib.sha256(str(now).encode())
    for i, step in enumerate(steps):
        name = step.name if i else None  # What led to the first is not known any more.
        digest.update(repr((name, step.document.up)).encode())
        for entry in step.document.photos:
            digest.update(repr((entry.name, entry.pairs, entry.enabled)).encode())
            digest.update(entry.camera.P.tobytes())
    return digest.hexdigest()


def tell(told: IO[str], line: str) -> None:
    """Writes a line at once; one write, so that it is whole or not there."""
    os.write(told.fileno(), (line + "\n").encode())


if __name__ == "__main__":
    sys.exit(main())
