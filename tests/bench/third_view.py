"""How true textured models of real sets look from a camera that took none of the photos."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from photoreg.camera import Camera
from photoreg.formats.cameras_json import load_cameras
from photoreg.mesh import Mesh, load_mesh
from photoreg.photo import load_photo
from photoreg.registration import refine
from photoreg.texture import bake_texture
from tests.bench.metrics import Metric, Setting, bench
from tests.third_view import likeness

VIEWS = {
    "granite": ("IMG_3028.jpg", "IMG_3030.jpg", "IMG_3029.jpg"),
    "temple": ("templeR0019.jpg", "templeR0023.jpg", "templeR0021.jpg"),
}
"""Set: the pair of photos, and the photo between them that is held out."""
START = "{}_{}-easy-00.json"


@bench
def third_view(setting: Setting) -> Iterator[Metric]:
    """PSNR where the model is painted: with the true cameras, and with refined ones.

    Refined cameras may be slid over the object together, all alike: the held-out photo
    shows that, no picture of the model does. So the figure is given twice, the second
    time with the held-out camera slid along. Granite, measured: 30.6 dB true, 29.0
    refined, 29.7 slid along, which moves the photo by 0.37 px; the pair was 0.6 px off
    cameras that are themselves known to some tenths.
    """
    if setting.data is None:
        return
    for name, (*pair, third) in VIEWS.items():
        folder = setting.data / name
        mesh = load_mesh(next(folder.glob("mesh.*")))
        true = load_cameras(folder / "cameras.json").cameras
        photos = [load_photo(folder / "photos" / photo) for photo in pair]
        stems = [photo.rpartition(".")[0] for photo in pair]
        start = load_cameras(folder / "starts" / START.format(*stems))
        *_, last = refine(mesh, photos, start.of_photos(photos))
        truth = load_photo(folder / "photos" / third).pixels
        exact = [true[photo] for photo in pair]
        slid = slid_along(true[third], exact, list(last.cameras), mesh)
        for what, cameras, view, bar in (
            ("true", exact, true[third], 30.0),
            ("refined", last.cameras, true[third], None),
            ("refined_slid", last.cameras, slid, None),
        ):
            found = likeness(bake_texture(mesh, photos, cameras), view, truth, True)
            note = f"SSIM {found.ssim:.3f}, {found.n_pixels:,} pixels"
            yield Metric(
                f"third_view.{name}.{what}",
                found.psnr_db,
                "dB",
                "higher",
                bar,
                0.02,
                note,
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
