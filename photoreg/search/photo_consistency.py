"""Photo-consistency: how well photos agree on the surface, as a function of cameras."""

import dataclasses
from collections.abc import Sequence

import numba as nb
import numpy as np
from jaxtyping import Bool, Float, Float32

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import SurfaceSamples, surface_patches
from photoreg.imaging.blur import blurred_within
from photoreg.imaging.colour import convert
from photoreg.imaging.photo import Photo
from photoreg.parameters.genes import GeneMap, Poses
from photoreg.search.config import ConsistencyConfig
from photoreg.search.kernels import population_costs
from photoreg.search.kernels_mncc import population_mncc


@dataclasses.dataclass(frozen=True, eq=False)
class PhotoStack:
    """Photos reduced, in a colour space, blurred, one after the other in memory."""

    pixels: Float32[np.ndarray, "total 4"]
    """Three colour channels and validity (1 inside the mask, 0 outside)."""
    layouts: np.ndarray
    """(m, 3) int64: first row in ``pixels``, width and height of each photo."""
    full_sizes: np.ndarray
    """(m, 2) width and height of the photos as given."""
    has_mask: bool
    """Whether any pixel is invalid."""


def stack_photos(photos: Sequence[Photo], config: ConsistencyConfig) -> PhotoStack:
    """Prepares photos for sampling; the full photos are never copied as floats."""
    parts, layouts, offset = [], [], 0
    for photo in photos:
        small = photo.resized(config.max_side_px)
        colours = convert(small.pixels, config.colour)
        valid = np.ones(colours.shape[:2], dtype=np.float32)
        if small.mask is not None:
            valid = small.mask.astype(np.float32)
        if config.blur_px > 0.0:
            colours = blurred_within(colours, valid, config.blur_px)
        parts.append(np.dstack([colours, valid]).reshape(-1, 4))
        layouts.append((offset, small.width, small.height))
        offset += small.width * small.height
    return PhotoStack(
        np.concatenate(parts),
        np.array(layouts, dtype=np.int64),
        np.array([[photo.width, photo.height] for photo in photos]),
        any(photo.mask is not None for photo in photos),
    )


class PhotoConsistency:
    """The cost of cameras: samples, photos, colour space and reducer, bound together."""

    def __init__(
        self,
        samples: SurfaceSamples,
        photos: Sequence[Photo],
        config: ConsistencyConfig | None = None,
        allowed: Bool[np.ndarray, "m n"] | None = None,
        patches: Float[np.ndarray, "n q 3"] | None = None,
        stack: PhotoStack | None = None,
    ) -> None:
        """Binds samples and photos.

        Args:
            samples: Points on the surface.
            photos: Two or more.
            config: How they are compared; None: the defaults.
            allowed: Samples each photo may show; the others are known to be hidden.
            patches: Points around each sample, for the mncc cost only; see
                ``patches_of``.
            stack: The photos as ``stack_photos`` prepares them, if that was done; None:
                it is done here.

        Raises:
            InputError: with fewer than two photos, or mncc without patches.
        """
        if len(photos) < 2:
            raise InputError(
                f"Photo-consistency compares photos, but there is {len(photos)}; give "
                "at least two."
            )
        self.config = ConsistencyConfig() if config is None else config
        self.samples = samples
        self.stack = stack_photos(photos, self.config) if stack is None else stack
        # The kernel works in float32: centre and scale the world to O(1) for it.
        self._origin = samples.points.mean(axis=0)
        self._scale = float(np.abs(samples.points - self._origin).max()) or 1.0
        scaled = (samples.points - self._origin) / self._scale
        along = np.einsum("nd,nd->n", samples.normals, scaled)
        self._points = np.ascontiguousarray(
            np.column_stack([scaled, samples.normals, along]).T, dtype=np.float32
        )
        self._patches = None
        if self.config.cost == "mncc":
            if patches is None:
                raise InputError("The mncc cost compares patches; give their points.")
            self._patches = ((patches - self._origin) / self._scale).astype(np.float32)
        self._allowed = np.ones((len(photos), len(samples)), dtype=np.uint8)
        if allowed is not None:
            self.allow(allowed)
        self.min_samples = 1
        self._reference_spread = 0.0
        self.evaluations = 0

    def allow(self, allowed: Bool[np.ndarray, "m n"]) -> None:
        """Sets which samples each photo may show; the others never vote."""
        self._allowed = np.ascontiguousarray(allowed, dtype=np.uint8)

    def require(self, cameras: Sequence[Camera]) -> None:
        """Measures the others by these cameras.

        A finite cost needs ``min_share`` of the samples that these see in common; and
        if the cost is ``relative``, it is so to the variance of the colours they see.
        """
        self.min_samples, self._reference_spread = 1, 1.0
        _, counts, spreads = self._evaluate(_poses_of(cameras))
        self.min_samples = max(1, int(self.config.min_share * counts[0]))
        self._reference_spread = float(spreads[0]) if self.config.relative else 0.0

    def cost(self, cameras: Sequence[Camera]) -> float:
        """The cost of one set of cameras; +inf when they see too little in common."""
        return float(self._evaluate(_poses_of(cameras))[0][0])

    def cost_and_chance(self, cameras: Sequence[Camera]) -> tuple[float, float]:
        """The cost, and the variance of the colours seen.

        Unrelated photos of the same contrast would cost about that variance, because
        exposure is solved along: the best gain between them is none.
        """
        costs, _, spreads = self._evaluate(_poses_of(cameras))
        return float(costs[0]), float(spreads[0])

    def n_common(self, cameras: Sequence[Camera]) -> int:
        """How many samples at least two of the photos see."""
        return int(self._evaluate(_poses_of(cameras))[1][0])

    def costs(
        self, genes: Float[np.ndarray, "p g"], gene_map: GeneMap
    ) -> Float[np.ndarray, "p"]:
        """The costs of a population."""
        self.evaluations += len(genes)
        return self._evaluate(gene_map.poses(genes))[0]

    def _evaluate(self, poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        config = self.config
        projections, centers = self._normalised(poses)
        n_chunks = min(len(projections), 4 * nb.get_num_threads())
        if self._patches is not None:
            costs, counts = population_mncc(
                self._points,
                self._patches,
                projections,
                centers,
                self._allowed,
                self.stack.pixels,
                self.stack.layouts,
                config.min_cosine,
                self.min_samples,
                n_chunks,
            )
            return costs, counts, np.zeros(len(costs))
        low_share, high_share = config.trimmed_shares
        return population_costs(
            self._points,
            projections,
            centers,
            self._allowed,
            self.stack.pixels,
            self.stack.layouts,
            self.stack.has_mask,
            config.min_cosine,
            low_share,
            high_share,
            config.cost == "variance",
            config.exposure,
            self._reference_spread,
            self.min_samples,
            n_chunks,
        )

    def _normalised(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """Projections and centres for the scaled points and the reduced photos."""
        ratio = self.stack.layouts[:, 1:] / self.stack.full_sizes
        reduce = np.zeros((len(ratio), 3, 3))
        reduce[:, 0, 0], reduce[:, 1, 1], reduce[:, 2, 2] = ratio[:, 0], ratio[:, 1], 1
        # Pixel centres: x_new = (x + 1/2) ratio - 1/2.
        reduce[:, :2, 2] = 0.5 * ratio - 0.5
        to_world = np.diag([self._scale, self._scale, self._scale, 1.0])
        to_world[:3, 3] = self._origin
        projections = reduce @ poses.P @ to_world
        # Depths of O(1): rounding of the pixel is then relative to 1.
        depth = np.abs(projections[..., 2, 3])
        projections /= np.maximum(depth, 1e-12)[..., None, None]
        centers = (poses.centers - self._origin) / self._scale
        return (
            np.ascontiguousarray(projections, dtype=np.float32),
            np.ascontiguousarray(centers, dtype=np.float32),
        )


def patches_of(
    mesh: Mesh,
    samples: SurfaceSamples,
    cameras: Sequence[Camera],
    config: ConsistencyConfig,
) -> Float[np.ndarray, "n q 3"]:
    """The patches of the mncc cost: ``patch_step_px`` apart as these cameras see them."""
    steps = []
    for camera in cameras:
        reduction = min(1.0, config.max_side_px / max(camera.width, camera.height))
        depth = np.abs(camera.to_camera(samples.points)[:, 2])
        steps.append(config.patch_step_px * depth / (camera.focal_px * reduction))
    return surface_patches(
        mesh, samples, np.median(np.array(steps), axis=0), config.patch_side
    )


def _poses_of(cameras: Sequence[Camera]) -> Poses:
    return Poses(
        np.array([[camera.K for camera in cameras]]),
        np.array([[camera.R_cam_world for camera in cameras]]),
        np.array([[camera.t_cam_world for camera in cameras]]),
    )
