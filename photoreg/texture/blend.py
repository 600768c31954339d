"""Photos onto texels: what each may be used for, and how much it counts there."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.winding import facing_cameras
from photoreg.imaging.photo import Pair, Photo
from photoreg.texture import kernels
from photoreg.texture.config import TextureConfig
from photoreg.texture.usable_area import PreparedPhoto, find_usable_area

BUMP = 0.005
"""Size of the roughness that is smoothed before angles are judged, relative to the
mesh's diagonal."""
SMOOTHINGS = 8
TEXELS_AT_A_TIME = 2_000_000
"""Bounds the memory."""
EXPOSURE_SIDE_PX = 1024
EXPOSURE_TEXELS = 200_000
MIN_JOINT_TEXELS = 300
"""Fewer texels seen by two photos say nothing about their exposure."""


@dataclasses.dataclass(frozen=True, eq=False)
class TexelTable:
    """The texels that hold surface, and where on it each lies."""

    index: Int[np.ndarray, "n"]
    """Flat index of each texel in the texture, rising."""
    face: Int[np.ndarray, "n"]
    """Its face, int32."""
    inside: Bool[np.ndarray, "n"]
    """Whether its centre lies in the face; else it is beyond a chart's border, for
    bilinear lookups."""
    width: int
    """Width of the texture in texels."""
    corners_px: Float[np.ndarray, "m 3 2"]
    """Corners of all faces in texels."""
    per_unit: float
    """Mean texels along a unit of length of the surface."""

    def thinned(self, n: int) -> "TexelTable":
        """About ``n`` of the texels, evenly spread."""
        step = max(1, len(self.index) // n)
        # Copies: for strided views numba would compile every kernel once more.
        return dataclasses.replace(
            self,
            index=self.index[::step].copy(),
            face=self.face[::step].copy(),
            inside=self.inside[::step].copy(),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class TexelSums:
    """What the photos so far say of each texel; the kernels change it."""

    colours: Float[np.ndarray, "n 8"]
    """Weight, low band x 3, sharp weight, high band x 3, float32."""
    weight: Float[np.ndarray, "n"]
    """Weight of the photo that counts most, float32."""
    photo: Int[np.ndarray, "n"]
    """That photo, int16; -1 while no photo sees the texel."""
    quality: Float[np.ndarray, "n"]
    """How well that photo sees it, float32 in [0, 1]."""

    @classmethod
    def zero(cls, n: int) -> "TexelSums":
        """Sums of ``n`` texels before the first photo."""
        return cls(
            np.zeros((n, 8), dtype=np.float32),
            np.zeros(n, dtype=np.float32),
            np.full(n, -1, dtype=np.int16),
            np.zeros(n, dtype=np.float32),
        )


def outward_normals(
    mesh: Mesh, cameras: Sequence[Camera]
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth normals of vertices, and face normals, that look to the cameras' side."""
    mesh = facing_cameras(mesh, cameras)
    return _smooth_normals(mesh), mesh.face_normals


def _smooth_normals(mesh: Mesh) -> Float[np.ndarray, "k 3"]:
    """Normals of vertices without the mesh's roughness.

    Scanned surfaces are rough; seen at a grazing angle, every bump of the ground would
    flip between painted and unpainted. Only vertices nearer than a bump have a say, so
    the edges of a coarse mesh stay as they are.
    """
    corners = mesh.position_index[mesh.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    length = np.linalg.norm(
        mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1
    )
    weight = np.exp(-((length / (BUMP * mesh.diagonal)) ** 2))
    n = len(mesh.vertices)
    ties = scipy.sparse.csr_array((weight, (edges[:, 0], edges[:, 1])), shape=(n, n))
    ties = scipy.sparse.csr_array(ties + ties.T)
    normals = mesh.vertex_normals[mesh.position_index]
    for _ in range(SMOOTHINGS):
        normals = normals + ties @ normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals[mesh.position_index]


def fitted_photo(photo: Photo, camera: Camera, mesh: Mesh, table: TexelTable) -> Photo:
    """The photo, reduced where it has far more pixels than texels would sample."""
    depth = camera.to_camera(mesh.vertices)[:, 2]
    if not (depth > 0.0).any():
        return photo
    excess = camera.focal_px / (np.median(depth[depth > 0.0]) * table.per_unit)
    if excess < 1.5:
        return photo
    return photo.resized(int(max(photo.width, photo.height) / excess))


def blend_photo(
    mesh: Mesh,
    normals: tuple[np.ndarray, np.ndarray],
    photo: PreparedPhoto,
    gain: np.ndarray,
    number: int,
    table: TexelTable,
    config: TextureConfig,
    sums: TexelSums,
) -> None:
    """Adds a photo to the sums of the texels that it sees.

    Args:
        mesh: The surface.
        normals: Of vertices and faces, by `outward_normals`.
        photo: By `find_usable_area`.
        gain: (3,) by which its channels are multiplied.
        number: The photo's, from 0.
        table: The texels.
        config: Settings.
        sums: Changed.
    """
    camera = photo.camera
    height, width = photo.depth.shape
    low_scale = np.array([photo.low.shape[1] / width, photo.low.shape[0] / height])
    inverse_K = np.linalg.inv(camera.K).T
    # In parts, so that memory holds what is known of one part's texels only.
    for start in range(0, len(table.index), TEXELS_AT_A_TIME):
        part = slice(start, start + TEXELS_AT_A_TIME)
        geometry = table.width, table.corners_px, mesh.vertices, mesh.faces
        index, face = table.index[part], table.face[part]
        weights, quality = kernels.weigh(
            index,
            face,
            *geometry,
            *normals,
            camera.P,
            inverse_K @ camera.R_cam_world,
            camera.center,
            camera.focal_px,
            photo.depth,
            photo.clearance,
            table.per_unit,
            float(np.cos(np.deg2rad(config.max_angle_deg))),
        )
        seen = np.flatnonzero(weights > 0.0)
        if len(seen) == 0:
            continue
        points = kernels.points_at(index[seen], face[seen], *geometry)
        # Depth at the nearest pixel let a few through whose occluder is narrower than
        # a pixel: on scans up to 4 of 1,000.
        free = mesh.is_unoccluded(points, camera.center)
        seen, points = seen[free], points[free]
        kernels.accumulate_photo(
            start + seen,
            points,
            weights[seen],
            quality[seen],
            camera.P,
            photo.pixels,
            photo.low,
            low_scale,
            gain,
            config.mode == "best",
            number,
            sums.colours,
            sums.weight,
            sums.photo,
            sums.quality,
        )


def seen_colours(
    mesh: Mesh,
    normals: tuple[np.ndarray, np.ndarray],
    photo: Photo,
    camera: Camera,
    table: TexelTable,
    config: TextureConfig,
) -> Float[np.ndarray, "n 3"]:
    """The colours that a photo, reduced, sees, float32; NaN where it sees nothing."""
    sums = TexelSums.zero(len(table.index))
    prepared = find_usable_area(
        mesh, photo.resized(EXPOSURE_SIDE_PX), camera, config.margin, config.feather
    )
    blend_photo(mesh, normals, prepared, np.ones(3), 0, table, config, sums)
    colours = np.full((len(table.index), 3), np.nan, dtype=np.float32)
    seen = sums.photo >= 0
    values = sums.colours[seen]
    colours[seen] = values[:, 1:4] / values[:, :1] + values[:, 5:] / values[:, 4:5]
    return colours


def log_colours(colours: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Logarithm of `seen_colours`; NaN too where they say nothing of exposure."""
    colours = colours.copy()
    # Neither black nor clipped: their ratios mean nothing.
    colours[~((colours > 8.0) & (colours < 247.0)).all(axis=1)] = np.nan
    return np.log(colours)


def exposure_gains(
    logs: Sequence[np.ndarray], pairs: Sequence[Pair]
) -> Float[np.ndarray, "n 3"]:
    """Gains by channel that make photos agree on the texels that two of them see.

    Least squares on the medians of the log ratios of pairs, so that a highlight
    or a passer-by does not count; the gains' geometric mean is 1.

    The gains that a refinement fits on its way are not used: they are those of CIE LUV,
    on blurred levels, and cameras need not come from a refinement. On a synthetic shell
    with one photo 15 to 25 % darker these are within 0.2 % of the true ones.

    Args:
        logs: For each photo what `log_colours` saw at the same texels.
        pairs: Which photos to compare.
    """
    n = len(logs)
    rows, ratios = [np.ones(n)], [np.zeros(3)]
    for j, i in pairs:
        difference = logs[i] - logs[j]
        difference = difference[np.isfinite(difference[:, 0])]
        if len(difference) < MIN_JOINT_TEXELS:
            continue
        row = np.zeros(n)
        row[i], row[j] = 1.0, -1.0
        # Pairs that share more say more, as far as their medians are noise.
        weight = np.sqrt(min(1.0, len(difference) / 5000.0))
        rows.append(weight * row)
        ratios.append(-weight * np.median(difference, axis=0))
    # Photos that share nothing with others are left as they are (minimum norm).
    log_gains = np.linalg.lstsq(np.array(rows), np.array(ratios), rcond=None)[0]
    return np.exp(log_gains)
