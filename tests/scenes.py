"""Small worlds with truth for the tests: cached, made in a moment, never symmetric.

Principal points are off the middle of the photo, the cameras are turned, stand at
different distances and have different focal lengths; the object is not centred.
"""

import functools

import numpy as np

from photoreg.geometry.mesh import Mesh
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import Scene, make_scene

WIDTH, HEIGHT = 320, 240


@functools.cache
def small_scene(
    seed: int = 0,
    kind: str = "clean",
    n_photos: int = 2,
    n_faces: int = 5_120,
    **settings: object,
) -> Scene:
    """A rock of 5,120 faces in photos of 320x240; rough cameras 5 to 8 px off.

    That is as far off, for the photo's size, as 15 to 25 px at 1,024. ``settings``
    are those of `SceneOptions`; scenes are shared between tests, so change nothing.
    """
    return make_scene(
        SceneOptions(
            kind=kind,  # pyright: ignore[reportArgumentType]
            seed=seed,
            n_photos=n_photos,
            n_faces=n_faces,
            **{  # pyright: ignore[reportArgumentType]
                "width": WIDTH,
                "height": HEIGHT,
                "error_px": (5.0, 8.0),
                "sensor_noise": 0.0,
                **settings,
            },
        )
    )


def on_a_site(scene: Scene, diagonals: float) -> Mesh:
    """The object, and a wall behind the cameras that is so many times as large."""
    mesh = scene.mesh
    middle = mesh.bounds.mean(axis=0)
    back = np.mean([camera.center for camera in scene.cameras], axis=0) - middle
    back /= np.linalg.norm(back)
    across, along = diagonals * mesh.diagonal * np.linalg.svd(back[None])[2][1:]
    behind = middle + 10.0 * mesh.diagonal * back
    wall = [behind + i * across + k * along for i, k in ((-1, -1), (1, -1), (1, 1))]
    n = len(mesh.vertices)
    faces = np.vstack([mesh.faces, [n, n + 1, n + 2]])
    return Mesh(np.vstack([mesh.vertices, wall]), faces)
