"""How well the photos agree, quickly enough to be told while a camera is dragged."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from app.model.state import Agreement
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import sample_surface
from photoreg.geometry.visibility import visible
from photoreg.geometry.winding import facing_cameras
from photoreg.imaging.photo import Photo
from photoreg.search.config import ConsistencyConfig
from photoreg.search.photo_consistency import PhotoConsistency

N_POINTS = 2_000
"""Points over the whole surface: some 2 ms on one core with two photos."""

SIDE_PX = 1024
BLUR_PX = 2.0
"""Photos are reduced and blurred: by hand, one is pixels off, and fine detail would
call everything farther than its own size no better than chance."""

MIN_COSINE = 0.3
MIN_COMMON = 20
"""Fewer points in common tell nothing."""


class AgreementMeter:
    """Measures cameras of one scene; what does not change is prepared once.

    It runs numba's parallel kernels: only the worker's main thread may ask it.
    """

    def __init__(self, mesh: Mesh, photos: Sequence[Photo]) -> None:
        self._mesh = mesh
        self._samples = sample_surface(mesh, N_POINTS, seed=0)
        config = ConsistencyConfig(max_side_px=SIDE_PX, blur_px=BLUR_PX, min_cosine=0.0)
        self._consistency = PhotoConsistency(self._samples, photos, config)

    def agreement(self, cameras: Sequence[Camera]) -> Agreement:
        """How well the photos agree on the points that two or more of them see."""
        seen = visible(self._samples, cameras, self._mesh, "rays", MIN_COSINE)
        if not seen.any():
            seen = self._seen_if_turned(cameras)
        counts = seen.sum(axis=0)
        n_common, n_seen = int((counts >= 2).sum()), int((counts >= 1).sum())
        share = n_common / n_seen if n_seen else 0.0
        if n_common < MIN_COMMON:
            return Agreement(float("inf"), 0.0, share)
        self._consistency.allow(seen)
        cost, chance = self._consistency.cost_and_chance(cameras)
        return Agreement(cost, chance, share)

    def _seen_if_turned(self, cameras: Sequence[Camera]) -> np.ndarray:
        """Which points are seen of a mesh that turns its backs to the cameras."""
        mesh = facing_cameras(self._mesh, cameras)
        turned = (mesh.faces != self._mesh.faces).any(axis=1)[self._samples.face_index]
        normals = np.where(turned[:, None], -1.0, 1.0) * self._samples.normals
        samples = dataclasses.replace(self._samples, normals=normals)
        return visible(samples, cameras, mesh, "rays", MIN_COSINE)
