"""The .cam files of texrecon and MVE."""

from pathlib import Path

import numpy as np
import pytest

from photoreg.errors import OutputError
from photoreg.formats.cameras.camera_set import CameraSet
from tests.formats.camera_files import (
    NAMES,
    camera_set,
    general_cameras,
    points_before,
    write,
)


def test_texrecon_divides_by_the_longer_side_as_mve_does(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    folder, saved = write(tmp_path, "texrecon", cameras)
    for name, camera in cameras.cameras.items():
        rows = (folder / f"{Path(name).stem}.cam").read_text().splitlines()
        t, R = np.split(np.array(rows[0].split(), dtype=float), [3])
        f, _, _, aspect, ppx, ppy = map(float, rows[1].split())
        # CameraInfo::fill_calibration, TextureView::get_pixel_coords.
        width, height = camera.width, camera.height
        if width / height * aspect < 1.0:
            ax, ay = f * height / aspect, f * height
        else:
            ax, ay = f * width, f * width * aspect
        points = points_before(camera)
        x, y, z = (points @ R.reshape(3, 3).T + t).T
        pixels = np.column_stack(
            [ax * x / z + width * ppx - 0.5, ay * y / z + height * ppy - 0.5]
        )
        error = np.abs(pixels - camera.project(points)).max()
        assert error < 1e-6, error
        assert (folder / name).read_bytes() == cameras.photos[name].read_bytes()
    assert len(saved.files) == 6


def test_photos_of_one_stem_are_refused_for_texrecon(tmp_path):
    camera = general_cameras()[NAMES[0]]
    with pytest.raises(OutputError, match="without suffix"):
        write(tmp_path, "texrecon", CameraSet({"a.png": camera, "a.jpg": camera}))
