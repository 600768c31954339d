"""What people do with files of their own: drop them, click points, refine, download."""

import base64
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.ndimage import binary_erosion

from photoreg.geometry.camera import Camera, same_camera
from photoreg.synthetic.scene import Scene
from tests.browser.app import App
from tests.browser.driver import Driver, wait_until

N_PAIRS = 8
CLOSE_RAD = np.radians(12.0)
"""So near to the photo's side of the object a person stops turning."""

_DROP = """files => {
  const transfer = new DataTransfer();
  for (const [name, text] of files) {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    transfer.items.add(new File([bytes], name));
  }
  const send = kind => document.querySelector('canvas').dispatchEvent(
    new DragEvent(kind, {dataTransfer: transfer, bubbles: true, cancelable: true}));
  send('dragenter'); send('dragover');
  const shown = document.getElementById('photoreg-drop').style.display;
  send('drop');
  return [shown, document.getElementById('photoreg-drop').style.display];
}"""


def drop(driver: Driver, files: Mapping[str, bytes]) -> list[str]:
    """Drops files onto the page; tells how the target was shown before and after."""
    driver.dismiss_toasts()
    texts = [[name, base64.b64encode(data).decode()] for name, data in files.items()]
    return driver.page.evaluate(_DROP, texts)


def open_points(app: App) -> None:
    """Opens the Points tab of a view that nobody has turned: the model comes to fill it."""
    driver, (viewport, *_) = app.driver, app.page._viewports.values()
    driver.tab("Points")

    def fills() -> bool:
        driver.frames(1)  # It glides, and rests before its goal where nothing is drawn.
        place, _, is_alone = viewport._at_home or (np.full(3, np.inf), 1.0, False)
        off = np.abs(driver.viewport_camera()[0] - place).max()
        return is_alone and bool(off < 1e-4)

    wait_until(fills, "the model alone fills the view")


def in_picker(driver: Driver, pixel: Sequence[float] | np.ndarray) -> list[float]:
    """Window pixels of a pixel of the photo, once the panel is scrolled to show it."""
    driver.page.locator(".pr-view").scroll_into_view_if_needed()
    pixel = [float(v) for v in pixel]
    return driver.page.evaluate("p => photoreg.picker.toClient(...p)", pixel)


def places_to_click(
    app: App, camera: Camera, n: int
) -> list[tuple[tuple[int, int], np.ndarray]]:
    """Window pixels over the model that the photo sees, and where it does.

    Far apart on the model and in the photo: a click on a marker would only choose it.
    """
    spots, pixels, world = _shared_places(app, camera)
    assert len(spots) > 3 * n, "model and photo share much of the surface"
    chosen = [0]
    while len(chosen) < n:
        apart = [
            np.linalg.norm(at[:, None] - at[chosen][None], axis=2) / np.ptp(at)
            for at in (world, pixels)
        ]
        chosen.append(int(np.argmax(np.minimum(*apart).min(axis=1))))
    return [((int(spots[i][0]), int(spots[i][1])), pixels[i]) for i in chosen]


def turn_to_see(app: App, camera: Camera) -> None:
    """Turns the free view about the object to the side that the photo was taken from."""
    document, driver = app.state.document, app.driver
    assert document.mesh is not None
    frame, up = app.page.scene.frame, np.array(document.up)
    middle = frame.to_page(document.mesh.bounds.mean(axis=0))
    wanted = frame.to_page(camera.center) - middle
    for _ in range(12):
        position, _, _ = driver.viewport_camera()
        away = position - middle
        level = away - up * (away @ up)
        level /= np.linalg.norm(level)
        around = np.arctan2(wanted @ np.cross(up, level), wanted @ level)
        above = _elevation(wanted, up) - _elevation(away, up)
        if max(abs(around), abs(above)) < CLOSE_RAD:
            return
        # A drag over the canvas' height turns once around, whatever its width.
        canvas = driver.canvas()
        across, down = canvas["height"] / (2 * np.pi) * np.array([-around, above])
        corner = canvas["x"] + (40 if across > 0 else canvas["width"] - 40)
        driver.drag((corner, canvas["y"] + 40), (float(across), float(down)))
        driver.frames(3)
    raise AssertionError("Dragging did not turn the view to the photo's side.")


def _elevation(way: np.ndarray, up: np.ndarray) -> float:
    return float(np.arcsin(way @ up / np.linalg.norm(way)))


def _shared_places(
    app: App, camera: Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Window pixels over the model that the photo sees, where, and what they meet."""
    driver, frame = app.driver, app.page.scene.frame
    mesh = app.state.document.mesh
    assert mesh is not None
    position, R_page_cam, view_rad = driver.viewport_camera()
    canvas = driver.canvas()
    focal = 0.5 * canvas["height"] / np.tan(0.5 * view_rad)
    middle = (canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2)
    x, y = np.meshgrid(
        np.arange(int(canvas["x"]) + 20, int(canvas["x"] + canvas["width"]) - 20, 12),
        np.arange(int(canvas["y"]) + 20, int(canvas["y"] + canvas["height"]) - 20, 12),
    )
    spots = np.stack([x.ravel(), y.ravel()], axis=1)
    rays = np.column_stack([(spots - middle) / focal, np.ones(len(spots))])
    rays = rays @ R_page_cam.T
    start = np.repeat(frame.to_world(position)[None], len(rays), axis=0)
    faces, distances = mesh.first_hits(start, rays)
    # Nobody clicks on the very outline: half a pixel further is off the surface.
    on_it = (faces >= 0).reshape(x.shape)
    hit = np.flatnonzero(binary_erosion(on_it, np.ones((3, 3))))
    spots, world = spots[hit], (start + distances[:, None] * rays)[hit]
    ways = world - camera.center
    starts = np.repeat(camera.center[None], len(ways), axis=0)
    _, seen_at = mesh.first_hits(starts, ways)
    pixels = camera.project(world)
    good = (np.abs(seen_at - 1.0) < 1e-3) & camera.contains(pixels)
    return spots[good], pixels[good], world[good]


def click_pairs(app: App, places: Sequence[tuple[tuple[int, int], np.ndarray]]) -> None:
    """Clicks points in the photo and on the model, by turns."""
    driver = app.driver
    for i, (spot, pixel) in enumerate(places, 1):
        driver.page.mouse.click(*in_picker(driver, pixel))
        wait_until(
            lambda i=i: len(app.state.document.photos[app.state.selected].pairs) == i,
            f"point {i} in the photo",
            30,
        )
        driver.page.mouse.click(*spot)
        wait_until(
            lambda i=i: (
                len(app.state.document.photos[app.state.selected].whole_pairs) == i
            ),
            f"point {i} on the model",
            30,
        )


def files_of(scene: Scene) -> dict[str, bytes]:
    """A scene's mesh and photos as a person has them."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in scene.mesh.vertices.tolist()]
    lines += ["f " + " ".join(str(i + 1) for i in f) for f in scene.mesh.faces.tolist()]
    return {"mine.obj": "\n".join(lines).encode(), **scene.encoded}


def whole_way(app: App, scene: Scene) -> Iterator[str]:
    """From files to a textured model; yields the name of each step that is done."""
    driver, session = app.driver, app.session
    drop(driver, files_of(scene))
    wait_until(
        lambda: len(app.state.document.photos) == 2 and app.state.job is None,
        "mesh and photos are there",
    )
    wait_until(lambda: app.state.agreement is not None, "they are measured")
    yield "open"
    open_points(app)
    for i, entry in enumerate(app.state.document.photos):
        driver.page.keyboard.press(str(i + 1))
        wait_until(lambda i=i: app.state.selected == i, "the photo is chosen")
        driver.page.wait_for_function("() => photoreg.picker.ready()")
        driver.frames(3)
        true = scene.cameras[[p.name for p in scene.photos].index(entry.name)]
        turn_to_see(app, true)
        click_pairs(app, places_to_click(app, true, N_PAIRS))

        def solved(i: int = i) -> bool:
            solution, now = app.state.current_solution, app.state.document.photos[i]
            return (
                solution is not None
                and solution.resection is not None
                and same_camera(solution.resection.camera, now.camera)
            )

        wait_until(solved, "the camera stands where the points say")
        yield f"points{i + 1}"
    driver.tab("3 Refine")
    driver.click("Refine")
    wait_until(lambda: session.state.run.status == "review", "the run ends", 300)
    yield "refine"
    driver.click("Accept")
    driver.tab("4 Export")
    driver.click("Make the texture")
    wait_until(lambda: session.state.texture is not None, "the texture is made", 180)
    yield "texture"
    with driver.page.expect_download() as download:
        driver.click("Download the model")
    assert download.value.path().stat().st_size > 100_000
    yield "download"
