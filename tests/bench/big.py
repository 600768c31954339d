"""Big input: two million triangles and two photos of 50 megapixels, in the page."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from playwright.sync_api import sync_playwright

from app.control.controller import Controller
from app.model.session import with_cameras
from app.page.server import Page
from photoreg.formats.models.ply import save_mesh
from photoreg.geometry.mesh import Mesh
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import Scene, make_scene
from tests.bench.metrics import Metric, Setting, bench
from tests.bench.page import readouts
from tests.bench.served import served
from tests.browser.driver import FINE, Driver, launch, wait_until

WIDTH, HEIGHT = 8660, 5774
PROBE_S = 0.02
N_FRAMES = 8


@bench
def big(setting: Setting) -> Iterator[Metric]:
    """Time, memory and latency with 2 million triangles and two photos of 50 Mpx."""
    del setting
    scene = make_scene(SceneOptions(kind="clean", n_faces=20_480))
    with (
        served() as (session, controller, page),
        TemporaryDirectory() as folder,
        sync_playwright() as playwright,
    ):
        paths = _files(scene, Path(folder))
        before = _resident_mb(controller)
        browser = launch(playwright)
        window = browser.new_page(viewport={"width": 1280, "height": 800})
        driver = Driver(window, f"http://127.0.0.1:{page.port}", FINE, still=False)
        driver.dismiss_toasts()
        with _Probe(page) as probe:
            began = time.perf_counter()
            with window.expect_file_chooser() as chooser:
                driver.click("Open files …")
            chooser.value.set_files(paths)
            wait_until(
                lambda: len(session.state.document.photos) == 2,
                "all is read",
                400,
            )
            read_s = time.perf_counter() - began
            wait_until(lambda: session.state.agreement is not None, "measured", 400)
            shown_s = time.perf_counter() - began
        yield Metric("big.read", read_s, "s", "lower", None, 1.0, "until shown")
        yield Metric(
            "big.measured", shown_s, "s", "lower", None, 1.0, "until agreement"
        )
        yield Metric(
            "big.stall",
            1e3 * max(probe.delays),
            "ms",
            "lower",
            1000.0,
            1.0,
            "longest the server did not answer meanwhile",
        )
        for name, now in _resident_mb(controller).items():
            yield Metric(
                f"big.memory.{name}",
                now - before[name],
                "MB",
                "lower",
                tolerance=0.25,
                note="resident, more than without the files",
            )
        true = dict(zip([p.name for p in scene.photos], scene.cameras, strict=True))
        session.change(
            "True cameras",
            with_cameras(
                {
                    name.replace(".png", ".jpg"): camera.resized(WIDTH, HEIGHT)
                    for name, camera in true.items()
                }
            ),
        )
        driver.frames(N_FRAMES)
        began = time.perf_counter()
        driver.frames(N_FRAMES)
        frame_ms = 1e3 * (time.perf_counter() - began) / N_FRAMES
        note = "of the 3-D view, in software WebGL"
        yield Metric("big.frame", frame_ms, "ms", "lower", None, 1.0, note)
        yield from readouts("big.readout", session)
        browser.close()


def _files(scene: Scene, folder: Path) -> list[Path]:
    """The scene with its triangles split, 1,966,080 in all, and its photos enlarged."""
    small = _split(*_split(scene.mesh.vertices, scene.mesh.faces))
    bodies = [_split(*small)]
    # Two pebbles below it make the two million full.
    for side in (-1.0, 1.0):
        away = scene.mesh.diagonal * np.array([0.2 * side, -0.4, 0.0])
        bodies.append((0.2 * small[0] + away, small[1]))
    first = np.cumsum([0] + [len(vertices) for vertices, _ in bodies])
    mesh = Mesh(
        np.concatenate([vertices for vertices, _ in bodies]),
        np.concatenate([f + n for (_, f), n in zip(bodies, first, strict=False)]),
    )
    save_mesh(folder / "big.ply", mesh)
    paths = [folder / "big.ply"]
    for photo in scene.photos:
        large = cv2.resize(photo.pixels, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        path = folder / photo.name.replace(".png", ".jpg")
        cv2.imwrite(str(path), cv2.cvtColor(large, cv2.COLOR_RGB2BGR))
        paths.append(path)
    return paths


def _split(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each triangle in four, at the middles of its sides."""
    sides = np.sort(
        np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    )
    known, inverse = np.unique(sides, axis=0, return_inverse=True)
    middle = len(vertices) + inverse.reshape(3, -1)
    a, b, c = faces.T
    ab, bc, ca = middle
    parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    split = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.concatenate([vertices, vertices[known].mean(axis=1)]), split


class _Probe:
    """How late the server's event loop gets to what it is asked."""

    def __init__(self, page: Page) -> None:
        self._loop = page.server.get_event_loop()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self.delays = [0.0]

    def __enter__(self) -> "_Probe":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _ask(self) -> None:
        while not self._done.wait(PROBE_S):
            answered, began = threading.Event(), time.perf_counter()
            self._loop.call_soon_threadsafe(answered.set)
            answered.wait(60.0)
            self.delays.append(time.perf_counter() - began)


def _resident_mb(controller: Controller) -> dict[str, float]:
    """Resident memory of the server and of the worker, where /proc tells."""
    found = {}
    for name, pid in (("server", "self"), ("worker", controller.worker.pid)):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                found[name] = int(line.split()[1]) / 1024
    return found
