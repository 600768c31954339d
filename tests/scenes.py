"""Small worlds with truth for the tests: cached, made in a moment, never symmetric.

Principal points are off the middle of the photo, the cameras are turned, stand at
different distances and have different focal lengths; the object is not centred.
"""

import functools

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
