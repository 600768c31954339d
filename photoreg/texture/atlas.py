"""Texture coordinates of a mesh: its own, or projected charts."""

import dataclasses

import numpy as np
import xatlas
from jaxtyping import Float, Int

from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import rasterise
from photoreg.texture.charts import project_charts

PADDING_TEXELS = 6
"""Free texels between charts at the packing resolution, filled by the gutter."""

PACKING_RESOLUTION = 2048
"""Texels on a side that the padding is meant for."""

MAX_OVERLAP = 0.02
"""Share of the mesh's own charts that may lie on another before they are refused: one
texel cannot show two places."""


NO_AREA = 1e-12
"""Of the whole surface, or of the whole texture: less is rounding."""


@dataclasses.dataclass(frozen=True, eq=False)
class Atlas:
    """Where each face lies in the texture."""

    uv: Float[np.ndarray, "k 2"]
    """Texture coordinates in [0, 1], u to the right and v upwards."""
    uv_vertex: Int[np.ndarray, "k"]
    """The mesh's vertex each coordinate belongs to; vertices on seams have several."""
    uv_faces: Int[np.ndarray, "m 3"]
    """For each corner of each face the row in ``uv``."""
    aspect: float = 1.0
    """Width of the packed charts by their height: the shape of the texture."""
    is_own: bool = False
    """Whether these are the mesh's own coordinates."""
    why_anew: str = ""
    """Why the mesh's own coordinates are not these, where it has some: "overlaps"."""

    def corners_px(self, width: int, height: int) -> Float[np.ndarray, "m 3 2"]:
        """Corners of the faces in texels; (0, 0) is the centre of the top-left texel."""
        size = np.array([width, -height], dtype=np.float64)
        origin = np.array([-0.5, height - 0.5])
        return (self.uv * size + origin)[self.uv_faces]

    def faces_at_texels(self, width: int, height: int) -> Int[np.ndarray, "h w"]:
        """The face that lies at each texel's centre, int32; -1 where none does."""
        return _draw(self.uv, self.uv_faces, width, height)


def make_atlas(mesh: Mesh, keep_uv: bool = True) -> Atlas:
    """Texture coordinates for ``mesh``, one chart layout for all of it.

    Args:
        mesh: The surface.
        keep_uv: Use the mesh's own coordinates if it has valid ones: finite, within
            [0, 1], an area for every face that has one, hardly overlapping.
    """
    if not keep_uv or mesh.corner_uv is None:
        return _charts(mesh)
    own = _own_atlas(mesh, mesh.corner_uv)
    if isinstance(own, Atlas):
        return own
    return dataclasses.replace(_charts(mesh), why_anew=own)


def _own_atlas(mesh: Mesh, corner_uv: Float[np.ndarray, "m 3 2"]) -> Atlas | str:
    """The mesh's own coordinates, or why they cannot hold a texture."""
    uv = corner_uv.reshape(-1, 2)
    if not np.isfinite(uv).all() or uv.min() < -1e-6 or uv.max() > 1.0 + 1e-6:
        return "goes beyond the picture"
    flat = (mesh.face_areas > NO_AREA * mesh.area) & ~(_areas(corner_uv) > NO_AREA)
    if flat.any():
        return f"has no place for {flat.sum():,} of its {len(flat):,} faces"
    rows = np.column_stack([mesh.faces.reshape(-1), uv])
    unique, index = np.unique(rows, axis=0, return_inverse=True)
    uv_faces = index.reshape(-1, 3).astype(np.int32)
    uv = np.clip(unique[:, 1:], 0.0, 1.0)
    atlas = Atlas(uv, unique[:, 0].astype(np.int32), uv_faces, is_own=True)

    size = PACKING_RESOLUTION
    texels = _areas(atlas.corners_px(size, size)).sum()
    covered = int((atlas.faces_at_texels(size, size) >= 0).sum())
    # Rasterising covers the charts' area, up to their borders, when none overlap.
    if covered == 0 or texels > covered * (1.0 + MAX_OVERLAP):
        return "overlaps"
    return atlas


def _areas(corners: Float[np.ndarray, "m 3 2"]) -> Float[np.ndarray, "m"]:
    """Areas of triangles in the plane."""
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, ac = b - a, c - a
    return 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def _charts(mesh: Mesh) -> Atlas:
    """Charts by projection, packed by xatlas.

    Charts cut by xatlas were tried, and stretch less: at most 1.05 and 1.11 over 95 %
    of the demo (20,480 faces) and of a noisy scan (20,000), where these stretch by 1.6
    and 2.0. But they take 4.0 s and 3.7 s instead of 0.8 s and 0.5 s, and 228 s instead
    of 8 s for a noisy scan of 200,000 faces; there are more of them (58 and 728, not 21
    and 693), fill the texture no better (0.55 and 0.56, not 0.51 and 0.54), and the
    demo's texture is the same to 0.2 dB.
    """
    flat = project_charts(mesh, PADDING_TEXELS / PACKING_RESOLUTION)
    # Corners of one vertex at one place of a chart are one row; charts lie apart.
    corners = np.ascontiguousarray(flat.reshape(-1, 2), dtype=np.float32)
    _, first, row = np.unique(
        corners.view(np.uint64), return_index=True, return_inverse=True
    )
    packer = xatlas.Atlas()
    packer.add_uv_mesh(corners[first], row.reshape(-1, 3).astype(np.uint32))
    charts = xatlas.ChartOptions()
    charts.use_input_mesh_uvs = True
    packing = xatlas.PackOptions()
    packing.padding = PADDING_TEXELS
    packing.resolution = PACKING_RESOLUTION
    packer.generate(charts, packing)
    row, uv_faces, uv = packer.get_mesh(0)
    chart = packer.get_mesh_vertex_assignment(0)[1].astype(np.int32)
    atlas = Atlas(
        np.clip(uv.astype(np.float64), 0.0, 1.0),
        mesh.faces.ravel()[first[row]],
        uv_faces.astype(np.int32),
        aspect=packer.width / packer.height,
    )
    return _with_all_vertices(_with_slivers(atlas, chart), mesh)


def _with_all_vertices(atlas: Atlas, mesh: Mesh) -> Atlas:
    """Gives each vertex coordinates of its own where several share a place.

    Packing takes corners at one place of a chart for one.
    """
    if (atlas.uv_vertex[atlas.uv_faces] == mesh.faces).all():
        return atlas
    keys = atlas.uv_faces.astype(np.int64) * len(mesh.vertices) + mesh.faces
    pairs, index = np.unique(keys, return_inverse=True)
    rows, vertices = np.divmod(pairs, len(mesh.vertices))
    return dataclasses.replace(
        atlas,
        uv=atlas.uv[rows],
        uv_vertex=vertices,
        uv_faces=index.reshape(-1, 3).astype(np.int32),
    )


def _with_slivers(atlas: Atlas, chart: Int[np.ndarray, "k"]) -> Atlas:
    """Gives faces that xatlas left out one place, that of a corner.

    Faces without area in the layout are in no chart; their corners stay at (0, 0), or
    in the charts of their neighbours, and they would be drawn across all others.
    """
    of_corner = chart[atlas.uv_faces]
    lost = np.flatnonzero(
        (of_corner < 0).any(axis=1) | (of_corner != of_corner[:, :1]).any(axis=1)
    )
    if len(lost) == 0:
        return atlas
    corner = np.argmax(of_corner[lost], axis=1)
    place = atlas.uv[atlas.uv_faces[lost, corner]]
    vertex = atlas.uv_vertex[atlas.uv_faces[lost]]
    uv_faces = atlas.uv_faces.copy()
    uv_faces[lost] = len(atlas.uv) + np.arange(3 * len(lost)).reshape(-1, 3)
    return dataclasses.replace(
        atlas,
        uv=np.vstack([atlas.uv, np.repeat(place, 3, axis=0)]),
        uv_vertex=np.concatenate([atlas.uv_vertex, vertex.ravel()]),
        uv_faces=uv_faces,
    )


def _draw(uv: np.ndarray, uv_faces: np.ndarray, width: int, height: int) -> np.ndarray:
    flat = np.column_stack([uv, np.zeros(len(uv))])
    P = np.array(
        [
            [width, 0.0, 0.0, -0.5],
            [0.0, -height, 0.0, height - 0.5],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return rasterise(flat, uv_faces, P, 0.5, width, height)[0]
