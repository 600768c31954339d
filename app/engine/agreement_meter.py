"""How well the photos agree, computed quickly enough to show while a camera is dragged."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from app.model.state import Agreement
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import SurfaceSamples, sample_surface
from photoreg.geometry.visibility import samples_for, visible
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
        self._mesh, self._photos = mesh, photos
        self._compare_at(sample_surface(mesh, N_POINTS, seed=0))

    def _compare_at(self, samples: SurfaceSamples) -> None:
        self._samples = samples
        config = ConsistencyConfig(max_side_px=SIDE_PX, blur_px=BLUR_PX, min_cosine=0.0)
        self._consistency = PhotoConsistency(samples, self._photos, config)

    def agreement(self, cameras: Sequence[Camera]) -> Agreement:
        """How well the photos agree on the points that two or more of them see."""
        seen = self._seen(cameras)
        if (seen.sum(axis=0) >= 2).sum() < MIN_COMMON:
            # They may show a detail that has few of the points, or another one.
            samples = samples_for(self._mesh, cameras, N_POINTS, seed=0)
            if not np.array_equal(samples.points, self._samples.points):
                self._compare_at(samples)
                seen = self._seen(cameras)
        counts = seen.sum(axis=0)
        n_common, n_seen = int((counts >= 2).sum()), int((counts >= 1).sum())
        share = n_common / n_seen if n_seen else 0.0
        if n_common < MIN_COMMON:
            return Agreement(float("inf"), 0.0, share)
        self._consistency.allow(seen)
        cost, chance = self._consistency.cost_and_chance(cameras)
        return Agreement(cost, chance, share)

    def _seen(self, cameras: Sequence[Camera]) -> Bool[np.ndarray, "m n"]:
        """Which points each camera sees."""
        seen = visible(self._samples, cameras, self._mesh, "rays", MIN_COSINE)
        return seen if seen.any() else self._seen_if_turned(cameras)

    def _seen_if_turned(self, cameras: Sequence[Camera]) -> Bool[np.ndarray, "m n"]:
        """Which points are seen of a mesh that turns its backs to the cameras."""
        mesh = facing_cameras(self._mesh, cameras)
        turned = (mesh.faces != self._mesh.faces).any(axis=1)[self._samples.face_index]
        normals = np.where(turned[:, None], -1.0, 1.0) * self._samples.normals
        samples = dataclasses.replace(self._samples, normals=normals)
        return visible(samples, cameras, mesh, "rays", MIN_COSINE)
