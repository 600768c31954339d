"""How true textured models look from a camera that took none of the photos."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from photoreg.texture.bake import bake_texture
from tests.bench.metrics import Metric, Setting, bench
from tests.texture.third_view import Likeness, likeness, third_camera

VIEWS = {
    "granite": ("IMG_3028.jpg", "IMG_3030.jpg", "IMG_3029.jpg"),
    "temple": ("templeR0019.jpg", "templeR0023.jpg", "templeR0021.jpg"),
}
"""Set: the pair of photos, and the photo between them that is held out."""
START = "{}_{}-easy-00.json"
MIN_PSNR_DB = 30.0
MAX_LOSS_DB = 1.0
"""Refined cameras may cost so much of what the true ones give."""

MADE_VIEWS = {"between": 0.5, "beside": 1.4}
"""Where the camera of no photo stands: ``third_camera``'s ``way``."""


@bench
def third_view(setting: Setting) -> Iterator[Metric]:
    """PSNR where the model is painted: with the true cameras, and with refined ones.

    Refined cameras may be slid over the object together, all alike: the held-out photo
    shows that, no picture of the model does. So real sets have a third figure, with the
    held-out camera slid along.
    """
    yield from _made()
    if setting.data is not None:
        for name in VIEWS:
            yield from _real(name, setting.data / name)


def _made() -> Iterator[Metric]:
    scene = make_scene(SceneOptions(kind="clean", seed=3))
    *_, last = refine(scene.mesh, scene.photos, scene.rough_cameras)
    true, refined = (
        bake_texture(scene.mesh, scene.photos, cameras)
        for cameras in (scene.cameras, last.cameras)
    )
    for name, way in MADE_VIEWS.items():
        view = third_camera(scene, way)
        truth = scene.render(view)
        exact = likeness(true, view, truth)
        yield _figure(f"made.{name}.true", exact, MIN_PSNR_DB)
        found = likeness(refined, view, truth)
        yield _figure(f"made.{name}.refined", found, exact.psnr_db - MAX_LOSS_DB)


def _real(name: str, folder: Path) -> Iterator[Metric]:
    *pair, third = VIEWS[name]
    mesh = load_mesh(next(folder.glob("mesh.*")))
    true = load_cameras(folder / "cameras.json").cameras
    photos = [load_photo(folder / "photos" / photo) for photo in pair]
    stems = [photo.rpartition(".")[0] for photo in pair]
    start = load_cameras(folder / "starts" / START.format(*stems))
    *_, last = refine(mesh, photos, start.of_photos(photos))
    truth = load_photo(folder / "photos" / third).pixels
    exact = [true[photo] for photo in pair]
    best = likeness(bake_texture(mesh, photos, exact), true[third], truth, True)
    yield _figure(f"{name}.true", best, MIN_PSNR_DB)
    refined = bake_texture(mesh, photos, last.cameras)
    slid = slid_along(true[third], exact, list(last.cameras), mesh)
    for what, view in (("refined", true[third]), ("refined_slid", slid)):
        found = likeness(refined, view, truth, True)
        yield _figure(f"{name}.{what}", found, best.psnr_db - MAX_LOSS_DB)


def _figure(name: str, found: Likeness, bar_db: float) -> Metric:
    note = f"SSIM {found.ssim:.3f}, {found.n_pixels:,} pixels"
    return Metric(
        f"third_view.{name}", found.psnr_db, "dB", "higher", bar_db, 0.02, note
    )


def slid_along(
    held_out: Camera, true: list[Camera], refined: list[Camera], mesh: Mesh
) -> Camera:
    """The held-out camera after the motion of the object that the refined pair shows.

    One rigid motion G makes true cameras of X' = G X see what refined ones see of X, as
    nearly as a motion can; the held-out camera gets the same.
    """
    points = mesh.vertices[:: max(1, len(mesh.vertices) // 4000)]
    center, scale = mesh.centroid, mesh.diagonal
    seen = [
        camera.contains(camera.project(points)) & other.contains(other.project(points))
        for camera, other in zip(true, refined, strict=True)
    ]

    def moved(x: np.ndarray) -> np.ndarray:
        turn = Rotation.from_rotvec(x[:3]).as_matrix()
        return (points - center) @ turn.T + center + scale * x[3:]

    def residuals(x: np.ndarray) -> np.ndarray:
        places = moved(x)
        return np.concatenate(
            [
                (a.project(places[s]) - b.project(points[s])).ravel()
                for a, b, s in zip(true, refined, seen, strict=True)
            ]
        )

    x = least_squares(residuals, np.zeros(6), x_scale=1e-3).x
    turn = Rotation.from_rotvec(x[:3]).as_matrix()
    shift = center + scale * x[3:] - turn @ center
    return dataclasses.replace(
        held_out,
        R_cam_world=held_out.R_cam_world @ turn,
        t_cam_world=held_out.R_cam_world @ shift + held_out.t_cam_world,
    )
