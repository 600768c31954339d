"""The view through a photo is exact: the mesh covers its own picture, to the pixel."""

import dataclasses
import io

import cv2
import numpy as np
import pytest
from PIL import Image

from app.model.camera_moves import rolled
from app.model.session import setting
from app.model.state import Document, PhotoEntry
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo
from photoreg.synthetic.rock import rock_mesh
from tests.browser.driver import FINE, Driver, wait_until

WIDTH, HEIGHT, FINER = 960, 720, 3
MAX_MEAN_PX, MAX_PX = 0.3, 1.0
"""How far the two outlines may be apart, in pixels of the screen."""

_GLOW = """() => {
  const node = __viserMutable.nodeRefFromName['/clear/clay'];
  let found = 0;
  node.traverse(o => { if (o.isMesh && o.material.emissive) {
    o.material.emissive.set(1, 1, 1); o.material.emissiveIntensity = 20;
    found += 1; } });
  __viserMutable.requestRender();
  return found;
}"""
"""Makes the mesh evenly white, so that its outline is where half of that is reached."""


def hard_camera() -> Camera:
    """Principal point 60 px off, fx != fy, rolled by 12 degrees, lines bent by the lens."""
    camera = Camera.look_at(
        (1.8, 1.1, 3.4), (0.1, 0.05, 0), (0, 1, 0), 1000.0, WIDTH, HEIGHT
    )
    K = np.array([[1000.0, 0.0, 539.5], [0.0, 930.0, 299.5], [0.0, 0.0, 1.0]])
    return rolled(dataclasses.replace(camera, K=K, lens=Lens(k1=-0.1)), 12.0)


def silhouette_photo(mesh: Mesh, camera: Camera) -> Photo:
    """The mesh white on black, its edges smooth."""
    fine = camera.resized(FINER * WIDTH, FINER * HEIGHT)
    inside = render_geometry(mesh, fine).face_index >= 0
    grey = cv2.resize(
        np.where(inside, 255, 0).astype(np.uint8),
        (WIDTH, HEIGHT),
        interpolation=cv2.INTER_AREA,
    )
    return Photo("white.png", np.repeat(grey[:, :, None], 3, axis=2))


def outline(picture: np.ndarray) -> np.ndarray:
    """Points (n, 2) where the picture passes through half of its brightness.

    On the lines between pixel centres, by linear interpolation.
    """
    half = picture.astype(float) - 0.5 * np.percentile(picture, 99)
    points = []
    for axis in (0, 1):
        a = half if axis == 0 else half.T
        rows, columns = np.nonzero((a[1:] > 0.0) != (a[:-1] > 0.0))
        share = a[rows, columns] / (a[rows, columns] - a[rows + 1, columns])
        along = rows + share
        points.append(
            np.column_stack([columns, along] if axis == 0 else [along, columns])
        )
    return np.concatenate(points)


def compare(mesh: np.ndarray, photo: np.ndarray) -> tuple[float, float]:
    """Length of the mean offset between two closed outlines, and the largest distance.

    The mean offset is the shift that explains the offsets across the outline best.
    """
    apart = mesh[:, None, :] - photo[None, :, :]
    squared = (apart**2).sum(axis=2)
    nearest = np.argmin(squared, axis=1)
    # To the line through the nearest points: those lie up to half a pixel along it.
    offsets, normals = [], []
    for i, point in enumerate(mesh):
        around = photo[((photo - photo[nearest[i]]) ** 2).sum(axis=1) < 3.0**2]
        centre = around.mean(axis=0)
        normal = np.linalg.svd(around - centre)[2][1]
        offsets.append(float((point - centre) @ normal))
        normals.append(normal)
    shift = np.linalg.lstsq(np.array(normals), np.array(offsets), rcond=None)[0]
    return float(np.linalg.norm(shift)), float(np.abs(offsets).max())


def grab(driver: Driver) -> np.ndarray:
    """The canvas as grey values, in the screen's pixels."""
    driver.frames(4)
    data = driver.page.screenshot(clip=driver.canvas())  # pyright: ignore[reportArgumentType]
    return np.asarray(Image.open(io.BytesIO(data)).convert("L"))


@pytest.fixture(scope="module")
def scene():
    mesh, camera = rock_mesh(seed=0, subdivisions=3), hard_camera()
    return mesh, camera, silhouette_photo(mesh, camera)


@pytest.fixture(scope="module")
def app(open_app_once, scene):
    mesh, camera, photo = scene
    return open_app_once(Document(mesh, mesh, (PhotoEntry(photo, camera),)), FINE)


@pytest.fixture
def second_window(app, chromium):
    """Another browser on the same app, with another window and finer pixels."""
    window = chromium.new_page(
        viewport={"width": 1500, "height": 560}, device_scale_factor=1.5
    )
    yield Driver(window, f"http://127.0.0.1:{app.page.port}", pixel_ratio=1.5)
    window.close()


def look_through(app, driver: Driver, camera: Camera, mode: str) -> None:
    """Looks through the photo and waits until the view has got there."""
    driver.dismiss_toasts()
    driver.tab("2 Align")
    driver.choose("View", mode)
    centre = app.page.scene.frame.to_page(camera.center)

    def off() -> float:
        driver.frames(1)
        return float(np.abs(driver.viewport_camera()[0] - centre).max())

    # In *Look through* the view turns about a point a thousandth before the camera's centre.
    wait_until(lambda: off() < 1e-5, "the view is the photo's", 60)
    if mode == "Look through":
        there = "() => '/through/photo' in __viserMutable.nodeRefFromName"
        driver.page.wait_for_function(there)
    driver.frames(4)


def outlines_apart(app, driver: Driver) -> tuple[float, float]:
    """The photo's outline alone, then the mesh's over the photo blackened."""
    entry = app.state.document.photos[0]
    app.session.change(None, setting(mesh_opacity=0.0))
    photo = outline(grab(driver))
    black = dataclasses.replace(entry.photo, pixels=np.zeros_like(entry.photo.pixels))
    app.session.change(
        "Blacken", lambda state: with_photo(state, PhotoEntry(black, entry.camera))
    )
    app.session.change(None, setting(mesh_opacity=1.0))
    driver.frames(4)
    assert driver.page.evaluate(_GLOW) == 1
    mesh = outline(grab(driver))
    app.session.undo()
    assert min(len(photo), len(mesh)) > 300
    return compare(mesh, photo)


def with_photo(state, entry: PhotoEntry):
    document = dataclasses.replace(state.document, photos=(entry,))
    return dataclasses.replace(state, document=document)


@pytest.mark.parametrize("mode", ["Move the camera", "Look through"])
@pytest.mark.parametrize(
    "shape", ["tall", pytest.param("wide and fine", marks=pytest.mark.slow)]
)
def test_through_a_photo_the_mesh_covers_its_picture_to_the_pixel(
    app, scene, shape, mode, request
):
    driver = app.driver
    if shape != "tall":
        driver = request.getfixturevalue("second_window")
    look_through(app, driver, scene[1], mode)
    canvas = driver.canvas()
    mean, largest = outlines_apart(app, driver)
    print(
        f"{mode}, canvas {canvas}: mean offset {mean:.3f} px, largest {largest:.3f} px"
    )
    assert (canvas["width"] > canvas["height"]) == (shape != "tall")
    assert mean <= MAX_MEAN_PX, f"mean {mean:.3f} px, largest {largest:.3f} px"
    assert largest <= MAX_PX, f"mean {mean:.3f} px, largest {largest:.3f} px"


_PICKED = """() => {
  const canvas = document.querySelector('.pr-view canvas');
  const pen = canvas.getContext('2d');
  return pen.getImageData(canvas.width / 2, canvas.height / 2, 1, 1).data[0];
}"""


@pytest.mark.parametrize("mode", ["Move the camera", "Look through"])
def test_a_dark_photo_is_brightened_in_the_view_and_beside_it_and_stays_as_it_is(
    app, scene, mode
):
    driver, (_, camera, white) = app.driver, scene
    dark = dataclasses.replace(white, pixels=np.full_like(white.pixels, 25))
    entry = PhotoEntry(dark, camera)
    app.session.change("Darken", lambda state: with_photo(state, entry))
    app.session.change(None, setting(mesh_opacity=0.0, photo_gain=1.0))
    look_through(app, driver, camera, mode)

    def middle() -> float:
        picture = grab(driver)
        rows, columns = (n // 2 for n in picture.shape)
        return float(picture[rows - 5 : rows + 5, columns - 5 : columns + 5].mean())

    wait_until(lambda: middle() < 45.0, "the photo is dark", 30)
    slider = driver.page.get_by_role("slider", name="Brighten").locator("visible=true")
    slider.focus()
    before = driver.viewport_camera()[1]
    slider.press("ArrowRight")
    wait_until(lambda: app.state.photo_gain == 1.1, "the key moves the slider", 30)
    driver.frames(5)
    assert np.abs(driver.viewport_camera()[1] - before).max() < 1e-6
    slider.press("End")
    wait_until(lambda: app.state.photo_gain == 8.0, "it is to be brightened", 30)
    wait_until(lambda: middle() > 160.0, "the photo is brighter", 30)
    driver.tab("Points")
    driver.page.wait_for_function("() => photoreg.picker.ready()")
    wait_until(lambda: abs(driver.page.evaluate(_PICKED) - 200) <= 3, "so is this", 30)
    driver.tab("Overlay")
    assert app.state.document.photos[0].photo is dark
    app.session.change(None, setting(photo_gain=1.0))
    app.session.undo()
    driver.choose("View", "3-D scene")
