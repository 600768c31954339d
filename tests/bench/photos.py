"""Many photos around one object: how error and time grow with their number."""

import time
from collections.abc import Iterator

from photoreg.geometry.projection_error import projection_error
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from tests.bench.metrics import Metric, Setting, bench

WIDTH, HEIGHT = 512, 384
ERROR_PX = (7.5, 12.5)
"""Of the rough cameras: as far off, for the photos' size, as 15 to 25 px at 1,024."""
COUNTS = (2, 4, 8, 16, 32, 64)
MEAN_BAR_PX = 0.06


@bench
def photos(setting: Setting) -> Iterator[Metric]:
    """Rocks in 2, 4, 8 photos, 25 degrees apart; twice as many for each 3 of --n."""
    for n_photos in COUNTS[: 3 + (setting.n - 1) // 3]:
        scene = make_scene(
            SceneOptions(
                kind="clean",
                n_photos=n_photos,
                width=WIDTH,
                height=HEIGHT,
                error_px=ERROR_PX,
            )
        )
        began = time.process_time()
        *_, last = refine(scene.mesh, scene.photos, scene.rough_cameras)
        processor_s = time.process_time() - began
        error = projection_error(scene.mesh, scene.cameras, last.cameras)
        worst = max(camera.mean for camera in error.cameras)
        name = f"photos.{n_photos:02d}"
        note = f"worst photo {worst:.3f} px"
        yield Metric(f"{name}.error", error.mean, "px", "lower", MEAN_BAR_PX, note=note)
        yield Metric(f"{name}.time", processor_s, "CPU s", "lower", None, 1.0)
