"""A pose made to fit an outline: Gauss-Newton on the distances between two contours.

Each point of the mesh's rim is drawn to the nearest place of the photo's outline, and each
place of that to the nearest point of the rim, so neither a part too much nor one too few
goes unpunished. Distances count robustly: a stand or a hand in the outline must not pull.
"""

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import GeometryBuffer, render_geometry
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.freedom import Held
from photoreg.parameters.increments import Increments
from photoreg.polish.kernels import rim_rows

FIRST_CUT, LAST_CUT = 0.06, 0.015
"""Scale of the Cauchy cost at the first and the last step, over the photo's longer side."""
FRAME_PX = 1.5
"""Places so near the frame are where the photo ends, not the object."""
MOST_STEP = 0.25
"""Most that a step turns, in radians, and moves, over the distance."""


@dataclasses.dataclass(frozen=True, eq=False)
class Outline:
    """The outline of an object in a photo."""

    covered: Bool[np.ndarray, "h w"]
    pixels: Float[np.ndarray, "n 2"]
    """Places along it, without those at the frame."""
    normals: Float[np.ndarray, "n 2"]
    """Unit vectors across it, outwards."""
    tree: KDTree

    @property
    def side_px(self) -> int:
        """The photo's longer side."""
        return max(self.covered.shape)


def outline_of(covered: Bool[np.ndarray, "h w"], side_px: int) -> Outline | None:
    """The outline of an object at another size; None where the photo shows none of it."""
    height, width = covered.shape
    scale = side_px / max(height, width)
    size = max(2, round(width * scale)), max(2, round(height * scale))
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    share = cv2.resize(covered.astype(np.float32), size, interpolation=method)
    covered = share >= 0.5
    rows, columns = _rim_pixels(covered)
    if len(rows) < 8:
        return None
    smooth = cv2.GaussianBlur(share, (0, 0), 1.2)
    # The place between pixels where the share passes one half, to first order.
    slope = np.column_stack(
        [
            cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)[rows, columns],
            cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)[rows, columns],
        ]
    ).astype(np.float64)
    lengths = np.linalg.norm(slope, axis=1)
    good = lengths > 0.02
    rows, columns, slope, lengths = (a[good] for a in (rows, columns, slope, lengths))
    if len(rows) < 8:
        return None
    pixels = np.column_stack([columns, rows]).astype(np.float64)
    normals = -slope / lengths[:, None]
    return Outline(covered, pixels, normals, KDTree(pixels))


def _rim_pixels(covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of covered pixels beside others, away from the frame."""
    height, width = covered.shape
    inner = cv2.erode(
        covered.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    )
    rows, columns = np.nonzero(covered & (inner == 0))
    away = (columns >= FRAME_PX) & (rows >= FRAME_PX)
    away &= (columns <= width - 1 - FRAME_PX) & (rows <= height - 1 - FRAME_PX)
    return rows[away], columns[away]


def overlap(outline: Outline, view: GeometryBuffer) -> float:
    """Common area over joint area of the object in a photo and as a camera sees it."""
    joint = int((outline.covered | view.covered).sum())
    return int((outline.covered & view.covered).sum()) / max(1, joint)


def fit_outline(
    mesh: Mesh,
    outline: Outline,
    camera: Camera,
    n_steps: int,
    *,
    first_cut: float = FIRST_CUT,
    frees_focal: bool = False,
) -> tuple[Camera, float]:
    """Moves a camera so that the rim of a mesh falls on an outline.

    Args:
        mesh: The surface.
        outline: The object in the photo.
        camera: Where to start; of the photo's full size.
        n_steps: Steps of Gauss-Newton.
        first_cut: Scale of the Cauchy cost at the first step, over the longer side.
        frees_focal: Whether the focal length moves, too.

    Returns:
        The best camera met, of the photo's full size, and its overlap.
    """
    height, width = outline.covered.shape
    pivot = mesh.bounds.mean(axis=0)
    held = Held(principal_point=True, focal=not frees_focal)
    best, best_overlap = camera, -1.0
    cuts = np.geomspace(first_cut, LAST_CUT, n_steps) * outline.side_px
    for step in range(n_steps + 1):
        view = render_geometry(mesh, camera.resized(width, height))
        found = overlap(outline, view)
        if found > best_overlap:
            best, best_overlap = camera, found
        if step == n_steps:
            break
        moved = _step(outline, view, camera, pivot, held, cuts[step])
        if moved is None:
            break
        camera = moved
    return best, best_overlap


def _step(
    outline: Outline,
    view: GeometryBuffer,
    camera: Camera,
    pivot: np.ndarray,
    held: Held,
    cut_px: float,
) -> Camera | None:
    rows, columns = _rim_pixels(view.covered)
    if len(rows) < 8:
        return None
    increments = Increments(camera, pivot, PriorScales(), held)
    height, width = outline.covered.shape
    zero = np.zeros(increments.n)
    points = view.points[rows, columns]
    pixels, slopes = rim_rows(
        increments.record(zero, width, height), points, increments.n
    )
    # From the rim to the outline, and from the outline to the rim.
    _, nearest = outline.tree.query(pixels)
    _, back = KDTree(pixels).query(outline.pixels)
    rim = np.concatenate([np.arange(len(pixels)), back])
    place = np.concatenate([nearest, np.arange(len(outline.pixels))])
    normals = outline.normals[place]
    gap = np.einsum("nd,nd->n", normals, pixels[rim] - outline.pixels[place])
    apart = np.linalg.norm(pixels[rim] - outline.pixels[place], axis=1)
    weights = 1.0 / (1.0 + (apart / cut_px) ** 2)
    weights[: len(pixels)] *= 0.5 / len(pixels)
    weights[len(pixels) :] *= 0.5 / len(outline.pixels)
    J = np.einsum("nd,ndk->nk", normals, slopes[rim])
    free = increments.is_free
    J = J[:, free]
    normal = np.einsum("n,ni,nj->ij", weights, J, J)
    right = np.einsum("n,ni,n->i", weights, J, gap)
    damping = 1e-3 * np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(
        len(J[0])
    )
    try:
        solved = -np.linalg.solve(normal + damping, right)
    except np.linalg.LinAlgError:
        return None
    x = zero.copy()
    x[free] = solved
    moves = np.abs(x * increments.units)
    distance = increments.distance
    size = max(moves[:3].max(), moves[3:6].max() / distance, moves[6] / 0.5)
    if not np.isfinite(size):
        return None
    return increments.camera(x * min(1.0, MOST_STEP / max(size, 1e-12)))
