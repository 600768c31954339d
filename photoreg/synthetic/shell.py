"""A sea snail's shell: a tube wound into a helico-spiral, with ribs and a pattern.

The form is a field in space (negative inside): the tube's cross-section grows by a
constant factor with each turn about the axis, so the shell is the same at every size.
Turns join where they touch; the last one is cut open and hollowed out. The pattern is
a function of the place along the spiral and around the tube, found back from a point:
so the texture is solid and known at every point of the surface.

Units of this module: the tube's half width at the aperture is 1, the apex is at the
origin and the axis runs along -z.

References:
    Raup, "Geometric analysis of shell coiling", Journal of Paleontology 40 (1966).
    Fowler, Meinhardt and Prusinkiewicz, "Modeling seashells", SIGGRAPH 1992.
"""

import dataclasses

import fast_simplification
import numba as nb
import numpy as np
from jaxtyping import Float, Int

from photoreg.synthetic.isosurface import surface_net

TURNS = 9
"""Whorls followed up from the aperture; the next one would be under 2 % of the last."""
GRIDS = 60
"""Grids tried: where two sheets meet in one cell of one grid, another parts them. Of
the forms of seeds 0 to 29 one wants 17 grids, the others 7 at most."""
CELL_SIZES = 12
"""Grids of so many cell sizes are tried before they are moved."""
GRID_SHIFT = np.array([0.38, 0.62, 0.24])
"""How far they are then moved each time, in cells."""
OUTSIDE, INSIDE, RIM = 0, 1, 2
"""Layers of the surface."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShellForm:
    """Numbers of the form, in units of the aperture's half width."""

    growth: float = 1.62
    """Factor of size from one whorl to the next."""
    spread: float = 0.86
    """Distance of the tube's middle from the axis."""
    drop: float = 2.95
    """Distance of the tube's middle below the apex."""
    above: float = 1.0
    """Half height of the cross-section above its middle."""
    below: float = 1.62
    """Half height below: the drawn-out canal."""
    lean: float = 0.15
    """How far the canal bends back to the axis."""
    ribs: float = 13.0
    """Axial ribs a turn."""
    rib_height: float = 0.055
    """Height of the ribs."""
    cord_height: float = 0.008
    """Height of the spiral cords."""
    wall: float = 0.12
    """Thickness of the lip."""
    flare: float = 0.12
    """How far the lip turns out."""

    def array(self) -> Float[np.ndarray, "11"]:
        """The numbers in order, for the compiled field."""
        return np.array(dataclasses.astuple(self), dtype=np.float64)


def shell_field(points: Float[np.ndarray, "n 3"], form: ShellForm) -> np.ndarray:
    """About the distance to the surface at points (n, 3); negative inside."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    return _places(points, form.array())[:, 0]


def shell_places(
    points: Float[np.ndarray, "n 3"], form: ShellForm
) -> Float[np.ndarray, "n 6"]:
    """Where on the shell points of the surface are.

    Returns:
        Columns: the field; the angle along the spiral, 0 at the aperture and falling
        to the apex; the angle around the tube, 0 outwards and rising to the apex; the
        tube's size there, 1 at the aperture; the layer; how much farther the pillar
        on the axis is than the whorl, negative on the pillar itself.
    """
    return _places(np.ascontiguousarray(points, dtype=np.float64), form.array())


def shell_surface(
    form: ShellForm, n_faces: int
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Closed surface of about ``n_faces`` outward triangles, finer where it bends."""
    bottom = -(form.drop + form.below) - 0.35
    side = (form.spread + 1.0) * (1.0 + form.flare) + 0.3
    # Fine enough that the reduction chooses what stays, not the grid.
    cell = 0.045 * np.sqrt(20_480 / max(n_faces, 20_480))
    low, high = np.array([-side, -side, bottom]), np.array([side, side, 0.2])
    for attempt in range(GRIDS):
        moves, size = divmod(attempt, CELL_SIZES)
        net = surface_net(
            lambda points: shell_field(points, form),
            low - moves * cell * 0.98**size * GRID_SHIFT,
            high,
            cell * 0.98**size,
        )
        vertices, faces = _reduced(*_largest_piece(*net), n_faces)
        if _edges_join_two_faces(faces):
            return vertices, faces
    raise RuntimeError(f"No grid of {GRIDS} gives {form} a surface without pinches.")


def _reduced(
    vertices: np.ndarray, faces: np.ndarray, n_faces: int
) -> tuple[np.ndarray, np.ndarray]:
    # Mild passes keep the triangles' shape; each may end above the target.
    for _ in range(6):
        if len(faces) <= n_faces:
            break
        vertices, faces = fast_simplification.simplify(
            vertices, faces, target_count=n_faces, agg=3
        )[:2]
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces)


def _edges_join_two_faces(faces: np.ndarray) -> bool:
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    walked = edges[:, 0] * (faces.max() + 1) + edges[:, 1]
    return len(np.unique(walked)) == len(walked)


def _largest_piece(
    vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The connected piece of most faces: crumbs of the field at the apex are left."""
    label = np.arange(len(vertices))
    while True:
        lowest = label[faces].min(axis=1)
        new = label.copy()
        for corner in range(3):
            np.minimum.at(new, faces[:, corner], lowest)
        new = new[new]
        if np.array_equal(new, label):
            break
        label = new
    pieces = label[faces[:, 0]]
    faces = faces[pieces == np.bincount(pieces).argmax()]
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(faces.shape)


@nb.njit(nogil=True, cache=True)
def _smooth_min(a, b, radius):  # noqa: ANN001, ANN202
    """The lower of two fields, rounded where they cross (Quilez)."""
    h = max(radius - abs(a - b), 0.0) / radius
    return min(a, b) - 0.25 * h * h * radius


@nb.njit(nogil=True, cache=True)
def _places(points, form):  # noqa: ANN001, ANN202
    growth, spread, drop, above, below, lean = form[:6]
    ribs, rib_height, cord_height, wall, flare = form[6:]
    rate = np.log(growth) / (2.0 * np.pi)
    out = np.zeros((len(points), 6))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        radius = np.sqrt(x * x + y * y)
        # Right-handed, as nearly all snails are: the aperture on the right, apex up.
        turn = np.arctan2(-y, x)
        field, nearest = 1e9, 1e9
        for whorl in range(TURNS):
            along = turn - 2.0 * np.pi * whorl
            size = np.exp(rate * along)
            u = radius / size - spread
            v = z / size + drop
            u += lean * min(v, 0.0) ** 2
            height = above if v > 0.0 else below
            q = np.sqrt(u * u + (v / height) ** 2)
            if whorl > 0 and size * (q - 1.6) > field:
                continue  # Too far to matter: spares most of the work.
            around = np.arctan2(v / height, u)
            # Ribs and the lip's edge lean like growth lines.
            grown = along + 0.16 * np.sin(around + 0.4)
            shoulder = np.exp(-(((around - 0.95) / 0.38) ** 2))
            fade = 0.5 + 0.5 * np.tanh((around + 0.75) / 0.35)
            fade *= 0.5 + 0.5 * np.tanh((2.2 - around) / 0.25)
            crest = (0.5 + 0.5 * np.cos(ribs * grown)) ** 1.5 - 0.4
            cords = np.cos(26.0 * around)
            plain = 1.0 + 0.045 * shoulder
            relief = rib_height * crest * fade * (1.0 + 0.9 * shoulder)
            relief += cord_height * cords
            edge = plain + relief
            layer = OUTSIDE
            if whorl == 0:
                # The last whorl: turned out at the lip, cut there, and hollow.
                opening = np.exp(min(grown, 0.0) / 0.16)
                edge = plain * (1.0 + flare * opening) + relief * (1.0 - 0.7 * opening)
                tube = size * (q - edge)
                cut = radius * grown
                depth = min(max(-grown / 3.0, 0.0), 1.0)
                foot = np.exp(-(((around + 1.6) / 0.45) ** 2))
                hollow = plain * (1.0 + flare * opening) - wall * (1.0 + 0.8 * foot)
                hollow *= np.sqrt(1.0 - depth * depth)
                cavity = size * (hollow - q)
                solid = -_smooth_min(-tube, -cut, 0.12)
                solid = -_smooth_min(-solid, -cavity, 0.12)
                if cavity > tube and cavity > cut:
                    layer = INSIDE
                elif cut > tube:
                    layer = RIM
            else:
                solid = size * (q - edge)
            if solid < nearest:
                nearest = solid
                out[i, 1], out[i, 2], out[i, 3], out[i, 4] = grown, around, size, layer
            field = solid if whorl == 0 else _smooth_min(field, solid, 0.05 * size)
        # The pillar on the axis that the whorls wind about.
        low = -(drop + 0.9 * below)
        thick = 0.17 + 0.2 * max(z - low, 0.0)
        pillar = 0.95 * (np.sqrt(radius**2 + max(low - z, 0.0) ** 2) - thick)
        pillar = max(pillar, z + 0.6 * drop)
        field = _smooth_min(field, pillar, 0.35)
        out[i, 5] = pillar - nearest
        out[i, 0] = field
    return out
