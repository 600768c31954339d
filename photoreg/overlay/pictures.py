"""Pictures of a registration: one photo carried over the surface into another.

Where two photos are registered, the carried photo lies on the other without a shift;
blend, checkerboard, difference and edges make a shift visible. One thread, without the
interpreter lock: it may be called from anywhere, while a search runs.
"""

import dataclasses
from collections.abc import Sequence
from typing import Literal, get_args

import cv2
import numba as nb
import numpy as np
from jaxtyping import Bool, Float, UInt8

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo
from photoreg.overlay.surface_lines import shaded_normals

MIN_COSINE = 0.15
"""Surface seen at a flatter angle (81 degrees and more from its normal) is left out:
its few pixels would be smeared over many."""

RING_TOLERANCE = 4.0
"""How much more the surface may curve out to the ring around the sampled pixels: the
error of a plane grows with the square of the distance."""

LIVE_MAX_FACES = 200_000
"""Finer meshes are decimated for live pictures: smaller faces than pixels cost time
and change nothing that can be seen."""

QUICK_MAX_FACES = 10_000
"""The same for pictures that are overtaken within a fifth of a second: drawing 20,000
faces twice takes longer than carrying the pixels."""

OverlayMode = Literal[
    "blend", "checkerboard", "difference", "edges", "swipe", "carried"
]
"""``swipe``: one photo left of a line, the other right of it. ``carried``: the carried
photo alone where it is seen, to be shown in turn with the base."""

ORANGE = (255, 140, 0)
BLUE = (0, 110, 255)
GREY = (150, 150, 150)
EDGE_COLOUR = (255, 0, 200)


@dataclasses.dataclass(frozen=True, eq=False)
class AlignedPair:
    """Two pictures of the same size that show the same surface at the same pixels."""

    base: UInt8[np.ndarray, "h w 3"]
    """The photo that the other was carried onto."""
    carried: UInt8[np.ndarray, "h w 3"]
    """The other photo as it looks from the base's camera; black where not seen."""
    seen: Bool[np.ndarray, "h w"]
    """Where the carried photo sees the surface that the base shows."""


class LiveOverlay:
    """Overlays of the same photos on the same mesh under changing cameras.

    What does not change is prepared once: photos reduced to the picture's size, their
    masks, a mesh of no more faces than such a picture can show. The pictures are
    undistorted, as the cameras of the moment have it.
    """

    def __init__(
        self, mesh: Mesh, photos: Sequence[Photo], max_side_px: int = 1024
    ) -> None:
        if max_side_px < 16:
            raise InputError(
                f"max_side_px is {max_side_px}; an overlay needs at least 16 pixels."
            )
        self.mesh = mesh.decimated(LIVE_MAX_FACES)
        self.photos = tuple(photo.resized(max_side_px) for photo in photos)
        self.quick_mesh = self.mesh.decimated(QUICK_MAX_FACES)
        self._quick = tuple(photo.resized(max_side_px // 2) for photo in photos)

    def quick_pair(
        self, cameras: Sequence[Camera], onto: int, carried: int
    ) -> AlignedPair:
        """As ``pair``, with the carried photo at half the resolution: a fifth of the time.

        The photo underneath is as sharp as ever. For looking at while cameras move; a
        difference of the two would show the loss of sharpness.
        """
        below = self.photos[onto]
        picture, seen = _carry(
            self.quick_mesh, self._quick[carried], cameras[carried],
            _sized_like(cameras[onto], self._quick[onto]),
        )  # fmt: skip
        size = (below.width, below.height)
        grown = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
        # Linear, so that no unseen black is mixed into what counts as seen.
        whole = cv2.resize(255 * seen.astype(np.uint8), size) == 255
        base = undistorted_photo(below, cameras[onto])
        return AlignedPair(base.pixels, grown, whole)

    def pair(self, cameras: Sequence[Camera], onto: int, carried: int) -> AlignedPair:
        """Photo ``carried`` as seen from the camera of photo ``onto``.

        Args:
            cameras: One camera a photo, for the photos' full size.
            onto: Index of the photo underneath.
            carried: Index of the photo that is carried over.
        """
        picture, seen = _carry(
            self.mesh, self.photos[carried], cameras[carried],
            _sized_like(cameras[onto], self.photos[onto]),
        )  # fmt: skip
        base = undistorted_photo(self.photos[onto], cameras[onto])
        return AlignedPair(base.pixels, picture, seen)

    def shape_pair(self, cameras: Sequence[Camera], onto: int) -> AlignedPair:
        """One photo and, in place of another, the surface coloured by its normals."""
        photo, camera = self.photos[onto], cameras[onto]
        shape = shaded_normals(self.mesh, photo, camera, 1.0)
        seen = render_geometry(self.mesh, _sized_like(camera, photo).pinhole).covered
        return AlignedPair(undistorted_photo(photo, camera).pixels, shape, seen)

    def picture(
        self,
        cameras: Sequence[Camera],
        onto: int,
        carried: int,
        mode: OverlayMode = "blend",
        share: float = 0.5,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """The overlay of one photo on another, ready to be shown."""
        return compose(self.pair(cameras, onto, carried), mode, share)


def pose_picture(
    mesh: Mesh, photo: Photo, camera: Camera, max_side_px: int
) -> UInt8[np.ndarray, "h w 3"]:
    """A small picture of a photo with the surface over it, to see whether a pose is right."""
    overlay = LiveOverlay(mesh.decimated(QUICK_MAX_FACES), [photo], max_side_px)
    return compose(overlay.shape_pair([camera], 0), "blend")


def carry_over(
    mesh: Mesh,
    photo_from: Photo,
    camera_from: Camera,
    camera_to: Camera,
    max_side_px: int = 1024,
) -> tuple[UInt8[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """A photo as it looks from another camera, carried over the surface.

    Args:
        mesh: The surface.
        photo_from: The photo to carry over; outside its mask nothing is taken.
        camera_from: Its camera, for its full size.
        camera_to: Where the surface is looked at from, for its own photo's full size;
            its lens does not count.
        max_side_px: Longer side of the picture made; a smaller photo is not enlarged.

    Returns:
        The picture, and where it is seen. Not seen, and black, is what is off the
        mesh, occluded in the photo, nearly edge-on in it, outside it or its mask, or
        within a pixel of a silhouette, where the photo mixes two surfaces.
    """
    return _carry(
        mesh,
        photo_from.resized(max_side_px),
        camera_from,
        camera_to.reduced(max_side_px, least_px=1),
    )


def compose(
    pair: AlignedPair, mode: OverlayMode, share: float = 0.5
) -> UInt8[np.ndarray, "h w 3"]:
    """The picture of ``pair`` in one of the modes.

    Args:
        pair: Two pictures of the same surface.
        mode: How they are laid over each other.
        share: Of the carried photo in a blend; where a swipe's line is, as a share of
            the width; without meaning for the others. In [0, 1].
    """
    parts = (pair.base, pair.carried, pair.seen)
    match mode:
        case "blend":
            return blend(*parts, share)
        case "checkerboard":
            return checkerboard(*parts)
        case "difference":
            return difference(*parts)
        case "edges":
            return edges(*parts)
        case "swipe":
            return swipe(pair.base, blend(*parts, 1.0), share)
        case "carried":
            return blend(*parts, 1.0)
    raise InputError(
        f"There is no overlay called {mode!r}; there are "
        f"{', '.join(get_args(OverlayMode))}."
    )


def blend(
    base: UInt8[np.ndarray, "h w 3"],
    carried: UInt8[np.ndarray, "h w 3"],
    seen: Bool[np.ndarray, "h w"],
    share: float = 0.5,
) -> UInt8[np.ndarray, "h w 3"]:
    """Both mixed, with ``share`` of the carried photo; the base alone where not seen."""
    mixed = cv2.addWeighted(base, 1.0 - share, carried, share, 0.0)
    return _where(seen, mixed, base)


def checkerboard(
    base: UInt8[np.ndarray, "h w 3"],
    carried: UInt8[np.ndarray, "h w 3"],
    seen: Bool[np.ndarray, "h w"],
    n_squares: int = 12,
) -> UInt8[np.ndarray, "h w 3"]:
    """Squares of both in turn, ``n_squares`` along the longer side.

    Lines of the surface go on unbroken from square to square where the photos agree.
    """
    height, width = seen.shape
    side = max(width, height) / max(1, n_squares)
    columns = (np.arange(width) / side).astype(np.int64)
    rows = (np.arange(height) / side).astype(np.int64)
    odd = ((rows[:, None] + columns[None, :]) & 1).astype(bool)
    return _where(seen & odd, carried, base)


def difference(
    base: UInt8[np.ndarray, "h w 3"],
    carried: UInt8[np.ndarray, "h w 3"],
    seen: Bool[np.ndarray, "h w"],
    gain: float = 4.0,
) -> UInt8[np.ndarray, "h w 3"]:
    """Brightness differences, amplified ``gain`` times.

    Grey where both agree, orange where the base is brighter, blue where the carried
    photo is (told apart by colour-blind people too); the base, darkened, where not
    seen. A common difference of exposure (the median) is taken off first.
    """
    grey_base = cv2.cvtColor(base, cv2.COLOR_RGB2GRAY)
    grey_carried = cv2.cvtColor(carried, cv2.COLOR_RGB2GRAY)
    change = cv2.subtract(grey_base, grey_carried, dtype=cv2.CV_16S)
    exposure = 0
    if seen.any():
        # Every seventh pixel is enough for a median.
        exposure = int(np.median(change[seen][::7]))
    colours = _difference_colours(gain, exposure)[change + 255]
    dark = cv2.cvtColor(grey_base // 4, cv2.COLOR_GRAY2RGB)
    return _where(seen, colours, dark)


def edges(
    base: UInt8[np.ndarray, "h w 3"],
    carried: UInt8[np.ndarray, "h w 3"],
    seen: Bool[np.ndarray, "h w"],
    colour: tuple[int, int, int] = EDGE_COLOUR,
) -> UInt8[np.ndarray, "h w 3"]:
    """Edges of the carried photo, in one colour, over the base in grey.

    The strongest tenth of the gradients starts an edge, so that soft and hard
    photos both show some. The border of what is seen is no edge of the photo.
    """
    grey_base = cv2.cvtColor(base, cv2.COLOR_RGB2GRAY)
    # The base behind the unseen part leaves less of an edge there than black would.
    filled = _where(seen, carried, base)
    grey = cv2.GaussianBlur(cv2.cvtColor(filled, cv2.COLOR_RGB2GRAY), (0, 0), 1.2)
    gradient_x = cv2.Sobel(grey, cv2.CV_16S, 1, 0)
    gradient_y = cv2.Sobel(grey, cv2.CV_16S, 0, 1)
    inside = cv2.erode(seen.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    faint = cv2.cvtColor(grey_base, cv2.COLOR_GRAY2RGB)
    if not inside.any():
        return faint
    # Every seventh pixel is enough for a percentile.
    strength = np.abs(gradient_x[inside][::7].astype(np.int32))
    strength += np.abs(gradient_y[inside][::7])
    high = max(float(np.percentile(strength, 90.0)), 8.0)
    found = cv2.Canny(gradient_x, gradient_y, 0.4 * high, high) > 0
    faint[found & inside] = colour
    return faint


def swipe(
    left: UInt8[np.ndarray, "h w 3"],
    right: UInt8[np.ndarray, "h w 3"],
    position: float = 0.5,
) -> UInt8[np.ndarray, "h w 3"]:
    """One picture left of a line, another right of it.

    Args:
        left: A picture, such as the overlay before the refinement.
        right: Another of the same size, such as the overlay after it.
        position: Where the line is, as a share of the width, in [0, 1].
    """
    width = left.shape[1]
    column = round(min(max(position, 0.0), 1.0) * width)
    picture = right.copy()
    picture[:, :column] = left[:, :column]
    if 0 < column < width:
        picture[:, max(0, column - 1) : column + 1] = 255
    return picture


def _sized_like(camera: Camera, photo: Photo) -> Camera:
    return camera.resized(photo.width, photo.height)


def _where(mask: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """``first`` where the mask is true, else ``second`` (quicker than np.where)."""
    return cv2.copyTo(first, mask.view(np.uint8), second.copy())


def _difference_colours(gain: float, exposure: int) -> UInt8[np.ndarray, "511 3"]:
    """Colours of the differences -255 ... 255, of which ``exposure`` is grey."""
    change = np.arange(-255, 256) - exposure
    strength = np.clip(gain * change / 255.0, -1.0, 1.0)[:, None]
    end = np.where(strength > 0.0, np.array(ORANGE), np.array(BLUE))
    share = np.abs(strength)
    return np.rint((1.0 - share) * np.array(GREY) + share * end).astype(np.uint8)


def _carry(
    mesh: Mesh, photo_from: Photo, camera_from: Camera, camera_to: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """As `carry_over`, with the photo and the destination at their final sizes."""
    photo_from = undistorted_photo(photo_from, camera_from)
    camera_from = _sized_like(camera_from, photo_from).pinhole
    camera_to = camera_to.pinhole
    shown = render_geometry(mesh, camera_to)
    source = render_geometry(mesh, camera_from)
    mask = photo_from.mask
    picture, seen = _carry_pixels(
        shown.face_index,
        shown.depth,
        np.linalg.inv(camera_to.K @ camera_to.R_cam_world),
        camera_to.center,
        mesh.face_normals,
        camera_from.P,
        np.linalg.inv(camera_from.K).T @ camera_from.R_cam_world,
        camera_from.center,
        camera_from.focal_px,
        source.depth,
        photo_from.pixels,
        np.ones((1, 1), dtype=bool) if mask is None else mask,
        MIN_COSINE,
    )
    return picture, seen


@nb.njit(nogil=True, cache=True)
def _carry_pixels(  # noqa: ANN202 - a kernel takes bare arrays.
    face_index: Float[np.ndarray, "h w"],
    depth: Float[np.ndarray, "h w"],
    A_world_pixel: Float[np.ndarray, "3 3"],
    center_to: Float[np.ndarray, "3"],
    face_normals: Float[np.ndarray, "m 3"],
    P_from: Float[np.ndarray, "3 4"],
    A_plane_normal: Float[np.ndarray, "3 3"],
    center_from: Float[np.ndarray, "3"],
    focal_from: float,
    depth_from: Float[np.ndarray, "hs ws"],
    pixels_from: UInt8[np.ndarray, "hs ws 3"],
    mask_from: Bool[np.ndarray, "hs ws"],
    min_cosine: float,
):
    """Samples the source at each pixel of the destination, if it truly sees it.

    All four source pixels that the bilinear sample touches must show the plane of the
    point's own face. The plane's depth at a pixel is exact, however steep it is
    (1 / z is linear in the picture), so the tolerance is only for the curvature of
    the surface within a pixel: the size of a pixel on it, more where it is steep.
    A nearer depth means an occluder, a farther one a silhouette: both mix colours.
    The ring around them must roughly do so too, since optics and the reduction of
    the photo spread a silhouette over more than one pixel.
    """
    height, width = face_index.shape
    height_from, width_from = depth_from.shape
    masked = mask_from.size > 1
    picture = np.zeros((height, width, 3), dtype=np.uint8)
    seen = np.zeros((height, width), dtype=np.bool_)
    A, C, P, N = A_world_pixel, center_to, P_from, A_plane_normal
    for y in range(height):
        for x in range(width):
            face = face_index[y, x]
            if face < 0:
                continue
            z = depth[y, x]
            dx = z * (A[0, 0] * x + A[0, 1] * y + A[0, 2])
            dy = z * (A[1, 0] * x + A[1, 1] * y + A[1, 2])
            dz = z * (A[2, 0] * x + A[2, 1] * y + A[2, 2])
            px, py, pz = C[0] + dx, C[1] + dy, C[2] + dz
            depth_point = P[2, 0] * px + P[2, 1] * py + P[2, 2] * pz + P[2, 3]
            if depth_point <= 0.0:
                continue
            u = (P[0, 0] * px + P[0, 1] * py + P[0, 2] * pz + P[0, 3]) / depth_point
            v = (P[1, 0] * px + P[1, 1] * py + P[1, 2] * pz + P[1, 3]) / depth_point
            # Written so that NaN fails too.
            if not (0.0 <= u <= width_from - 1 and 0.0 <= v <= height_from - 1):
                continue
            nx = face_normals[face, 0]
            ny = face_normals[face, 1]
            nz = face_normals[face, 2]
            sx, sy, sz = px - center_from[0], py - center_from[1], pz - center_from[2]
            distance = np.sqrt(sx * sx + sy * sy + sz * sz)
            offset = nx * sx + ny * sy + nz * sz
            cosine = abs(offset) / distance
            # Both cameras must look at the same side of the face.
            if cosine < min_cosine or offset * (nx * dx + ny * dy + nz * dz) <= 0.0:
                continue
            ix, iy = min(int(u), width_from - 2), min(int(v), height_from - 2)
            steepness = np.sqrt(max(0.0, 1.0 - cosine * cosine)) / cosine
            tolerance = (1.5 + steepness) * depth_point / focal_from
            ax = (N[0, 0] * nx + N[0, 1] * ny + N[0, 2] * nz) / offset
            ay = (N[1, 0] * nx + N[1, 1] * ny + N[1, 2] * nz) / offset
            aw = (N[2, 0] * nx + N[2, 1] * ny + N[2, 2] * nz) / offset
            if not (
                _shows(depth_from[iy, ix], ax * ix + ay * iy + aw, tolerance)
                and _shows(
                    depth_from[iy, ix + 1], ax * (ix + 1) + ay * iy + aw, tolerance
                )
                and _shows(
                    depth_from[iy + 1, ix], ax * ix + ay * (iy + 1) + aw, tolerance
                )
                and _shows(
                    depth_from[iy + 1, ix + 1],
                    ax * (ix + 1) + ay * (iy + 1) + aw,
                    tolerance,
                )
            ):
                continue
            if masked and not (
                mask_from[iy, ix]
                and mask_from[iy, ix + 1]
                and mask_from[iy + 1, ix]
                and mask_from[iy + 1, ix + 1]
            ):
                continue
            tolerance *= RING_TOLERANCE
            left, right = max(ix - 1, 0), min(ix + 2, width_from - 1)
            top, bottom = max(iy - 1, 0), min(iy + 2, height_from - 1)
            if not (
                _shows(depth_from[top, left], ax * left + ay * top + aw, tolerance)
                and _shows(
                    depth_from[top, right], ax * right + ay * top + aw, tolerance
                )
                and _shows(
                    depth_from[bottom, left], ax * left + ay * bottom + aw, tolerance
                )
                and _shows(
                    depth_from[bottom, right], ax * right + ay * bottom + aw, tolerance
                )
            ):
                continue
            fx, fy = u - ix, v - iy
            for channel in range(3):
                upper = (1.0 - fx) * pixels_from[iy, ix, channel] + (
                    fx * pixels_from[iy, ix + 1, channel]
                )
                lower = (1.0 - fx) * pixels_from[iy + 1, ix, channel] + (
                    fx * pixels_from[iy + 1, ix + 1, channel]
                )
                value = (1.0 - fy) * upper + fy * lower
                picture[y, x, channel] = np.uint8(value + 0.5)
            seen[y, x] = True
    return picture, seen


@nb.njit(nogil=True, cache=True, inline="always")
def _shows(depth, inverse, tolerance):  # noqa: ANN001, ANN202
    """Whether |depth - 1 / inverse| <= tolerance; false where inverse is negative."""
    return abs(depth * inverse - 1.0) <= tolerance * inverse
