"""A transforms.json as nerfstudio makes it of COLMAP's cameras: the world is turned."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.nerfstudio import save_nerfstudio
from photoreg.geometry.camera import Camera

TURN = np.array([[0.0, 1, 0, 0.3], [1, 0, 0, -2.0], [0, 0, -1, 0.7]])
"""nerfstudio's turn of COLMAP's world, and a shift."""
SCALE = 2.5


def write_moved(path: Path, cameras: Mapping[str, Camera]) -> None:
    """Cameras in the world to which nerfstudio moves them, and what it says of it."""
    save_nerfstudio(path, CameraSet(cameras))
    document = json.loads(path.read_text(encoding="utf-8"))
    # As nerfstudio moves them: applied_transform first, then applied_scale.
    for frame in document["frames"]:
        pose = TURN @ np.array(frame["transform_matrix"])
        pose[:, 3] *= SCALE
        frame["transform_matrix"] = [*pose.tolist(), [0, 0, 0, 1]]
    document |= {"applied_transform": TURN.tolist(), "applied_scale": SCALE}
    path.write_text(json.dumps(document), encoding="utf-8")
