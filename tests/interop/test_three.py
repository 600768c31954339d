"""three.js, in a real browser, shows our GLB and OBJ with their texture.

`make test-interop` installs it where there is npm.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Route, sync_playwright

from photoreg.formats.models.registry import save_textured
from photoreg.geometry.camera import Camera
from photoreg.geometry.rasteriser import render_geometry
from photoreg.texture.bake import bake_texture
from tests.browser.driver import launch
from tests.painted import BACKDROP, ball_and_moon, cameras_around, paint, photograph

THREE = Path(__file__).parents[2] / ".venv/three/node_modules/three"
PAGE = Path(__file__).with_name("three_shows.html")
ADDRESS = "http://photoreg.test"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not THREE.is_dir(), reason="three.js is not there: no npm"),
]


def clip_from_camera(camera: Camera, near: float = 0.1, far: float = 100.0) -> list:
    """The projection (16 numbers) by which OpenGL draws what ``camera`` sees."""
    K, width, height = camera.K, camera.width, camera.height
    # OpenGL looks along -z with y up, and the picture goes from -1 to 1.
    depth = (far + near) / (near - far), 2.0 * far * near / (near - far)
    return [
        *(2 * K[0, 0] / width, 0, 1 - 2 * (K[0, 2] + 0.5) / width, 0),
        *(0, 2 * K[1, 1] / height, 2 * (K[1, 2] + 0.5) / height - 1, 0),
        *(0, 0, *depth),
        *(0, 0, -1, 0),
    ]


def world_from_camera(camera: Camera) -> list:
    """The pose (16 numbers) of ``camera`` with OpenGL's axes."""
    pose = np.eye(4)
    pose[:3, :3] = camera.R_cam_world.T @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = camera.center
    return pose.ravel().tolist()


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_three_shows_the_surface_in_its_true_colours(tmp_path, kind):
    mesh, (*cameras, view) = ball_and_moon(3), cameras_around(3)
    photos = [photograph(mesh, c, f"{i}.png") for i, c in enumerate(cameras)]
    save_textured(tmp_path / f"model.{kind}", bake_texture(mesh, photos, cameras))

    def answer(route: Route) -> None:
        path = route.request.url.removeprefix(ADDRESS)
        folders = {"/three/": THREE, "/model/": tmp_path}
        for prefix, folder in folders.items():
            if path.startswith(prefix):
                route.fulfill(path=folder / path.removeprefix(prefix))
                return
        route.fulfill(path=PAGE)

    with sync_playwright() as playwright:
        browser = launch(playwright)
        window = browser.new_page(viewport={"width": view.width, "height": view.height})
        complaints: list[str] = []
        window.on("pageerror", lambda error: complaints.append(str(error)))
        window.route(f"{ADDRESS}/**", answer)
        window.goto(f"{ADDRESS}/")
        window.wait_for_function("() => window.show !== undefined")
        size = {"width": view.width, "height": view.height}
        matrices = {
            "projection": clip_from_camera(view),
            "pose": world_from_camera(view),
        }
        window.evaluate(
            "async what => { await show(what); }", {"kind": kind, **size, **matrices}
        )
        shot = window.screenshot(path=tmp_path / "shot.png")
        browser.close()
    assert complaints == []
    bgr = cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None
    shown = bgr[:, :, ::-1].astype(float)

    buffer = render_geometry(mesh, view)
    on_model = (np.abs(shown - BACKDROP) > 40).any(axis=2)
    # They may differ where an edge runs through a pixel.
    outline = (on_model != buffer.covered).mean()
    assert outline < 0.002, outline
    true = np.zeros_like(shown)
    true[buffer.covered] = paint(buffer.points[buffer.covered])
    normals = mesh.face_normals[buffer.face_index]
    # Away from outlines, and where the photos see the surface well.
    well = cv2.erode(buffer.covered.astype(np.uint8), np.ones((9, 9))) > 0
    for camera in cameras:
        towards = camera.center - buffer.points
        towards /= np.linalg.norm(towards, axis=2, keepdims=True)
        well &= (normals * towards).sum(axis=2) > 0.5
    error = np.abs(shown - true)[well]
    assert well.sum() > 10_000, well.sum()
    assert np.percentile(error, 90) < 4.0, np.percentile(error, 90)
    assert error.mean() < 2.0, error.mean()
