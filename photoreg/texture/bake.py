"""Photos baked into one texture: each texel from the photos that truly see it."""

import dataclasses
from collections.abc import Generator, Sequence

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.unseen import why_unseen
from photoreg.imaging.pairs import choose_pairs
from photoreg.imaging.photo import Photo
from photoreg.texture import kernels
from photoreg.texture.atlas import Atlas, make_atlas
from photoreg.texture.blend import (
    EXPOSURE_TEXELS,
    TEXELS_AT_A_TIME,
    TexelSums,
    TexelTable,
    blend_photo,
    exposure_gains,
    fitted_photo,
    log_colours,
    outward_normals,
    seen_colours,
)
from photoreg.texture.config import MAX_SIZE, MIN_SIZE, TextureConfig
from photoreg.texture.fill_unseen import spread
from photoreg.texture.strangers import LEAST_PHOTOS, Stranger, find_strangers
from photoreg.texture.usable_area import find_usable_area

GROWN_RINGS = 2
"""Texels beyond a chart's border that are baked like those inside."""
MIN_SEEN_AT_VERTEX = 0.3
TEXELS_A_PIXEL = 1.25
"""Along a line, of the automatic size: charts stretch the surface here and press it
there, and a texel for a pixel blurs what it samples."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class TexturedMesh:
    """A mesh with one texture, in its original coordinates and vertex order."""

    mesh: Mesh
    """The surface as it was given."""
    atlas: Atlas
    """Where each face lies in the texture."""
    texture: UInt8[np.ndarray, "h w 3"]
    """sRGB, row 0 at the top (v = 1)."""
    photo_index: Int[np.ndarray, "h w"]
    """Which photo counts most at each texel, int16; -1: none sees it, -2: no surface."""
    quality: UInt8[np.ndarray, "h w"]
    """How well it is seen: 255 face-on with a photo pixel or more for each texel."""
    seen_share: float
    """Share of the surface's area that is painted from photos, in [0, 1]."""
    seen_share_by_photo: tuple[float, ...]
    """Share of the area for which each photo is the one that counts most."""
    gains: Float[np.ndarray, "n 3"]
    """By which each photo's channels were multiplied to even out exposure."""
    left_out_share_by_photo: tuple[float, ...] = ()
    """Of the surface that each photo sees, the share that was not painted from it, because
    other photos disagree: something stands before the object there."""
    config: TextureConfig
    """How it was made."""

    @property
    def vertices(self) -> Float[np.ndarray, "k 3"]:
        """Vertices in the order of the mesh."""
        return self.mesh.vertices

    @property
    def faces(self) -> Int[np.ndarray, "m 3"]:
        """Vertex indices of the faces, as in the mesh."""
        return self.mesh.faces

    @property
    def corner_uv(self) -> Float[np.ndarray, "m 3 2"]:
        """Texture coordinates of each face's corners, v upwards."""
        return self.atlas.uv[self.atlas.uv_faces]

    @property
    def layout_in_words(self) -> str:
        """Whose texture coordinates these are, and why not the mesh's own."""
        if self.atlas.is_own:
            return "laid out as the mesh's own"
        why = self.atlas.why_anew
        return (
            f"laid out anew, as the mesh's own layout {why}" if why else "laid out anew"
        )

    @property
    def coverage_colours(self) -> tuple[tuple[int, int, int], ...]:
        """The sRGB colour of each photo in the coverage picture, where it is brightest."""
        # The golden angle keeps the hues of any number of photos apart.
        hues = [(100 + 222.5 * photo) % 360 / 2 for photo in range(len(self.gains))]
        hsv = np.array([[[hue, 190, 255] for hue in hues]], np.uint8)
        rgb = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0].tolist()
        return tuple((red, green, blue) for red, green, blue in rgb)

    def coverage_picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """Which photo, by hue, and how well, by brightness; unseen surface is grey."""
        picture = np.zeros((*self.photo_index.shape, 3), dtype=np.uint8)
        picture[self.photo_index == -1] = 60
        for photo, colour in enumerate(self.coverage_colours):
            texel = self.photo_index == photo
            shade = 0.35 + 0.65 * self.quality[texel, None] / 255.0
            picture[texel] = (shade * np.array(colour)).astype(np.uint8)
        return picture


@dataclasses.dataclass(frozen=True)
class BakingStep:
    """What comes next in the making of a texture."""

    title: str
    """In words, for a progress bar."""
    fraction: float
    """Share of the work done, in [0, 1], by rule of thumb."""


def bake_texture(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: TextureConfig | None = None,
    atlas: Atlas | None = None,
) -> TexturedMesh:
    """Paints the photos onto the mesh: `baking` without its steps."""
    *_, textured = baking(mesh, photos, cameras, config, atlas)
    assert isinstance(textured, TexturedMesh)
    return textured


def baking(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: TextureConfig | None = None,
    atlas: Atlas | None = None,
) -> Generator[BakingStep | TexturedMesh]:
    """Paints the photos onto the mesh, step by step; stop iterating to cancel.

    Each texel takes colours from the photos that see its surface point: inside the
    photo and its mask, facing it, not occluded (a ray decides), away from silhouettes.
    Weights grow with resolution, with the angle and with the distance to edges.

    Photos are worked on one after the other, so the memory needed beside them does not
    grow with their number.

    Args:
        mesh: The surface.
        photos: Any number of photos.
        cameras: One camera a photo, for its full size.
        config: Settings; None: the defaults.
        atlas: Texture coordinates made before for this mesh; None: made now.

    Yields:
        Steps, and last of all the textured mesh.

    Raises:
        InputError: if photos and cameras do not match, unseen faces are to keep
            colours that the mesh does not have, or no photo sees the surface; the
            sentence says what may be wrong with the cameras' world.
    """
    config = config or TextureConfig()
    _check_photos(photos, cameras)
    _check_own_colours(mesh, config)
    if atlas is None:
        yield BakingStep("Unfolding the surface", 0.0)
        atlas = make_atlas(mesh, config.keep_uv)
    yield BakingStep("Laying out the texture", 0.2)
    density = _pixels_per_unit(mesh, cameras)
    width, height = _texture_size(mesh, atlas, density, config)
    table = _texel_table(mesh, atlas, width, height)
    normals = outward_normals(mesh, cameras)

    n = len(photos)
    gains = np.ones((n, 3))
    looks_for_strangers = config.leave_out_strangers and n >= LEAST_PHOTOS
    strangers: list[Stranger] = []
    if (config.even_exposure and n > 1) or looks_for_strangers:
        few, colours = table.thinned(EXPOSURE_TEXELS), []
        for i, (photo, camera) in enumerate(zip(photos, cameras, strict=True)):
            yield BakingStep(f"Comparing exposures: {photo.name}", 0.25 + 0.15 * i / n)
            colours.append(seen_colours(mesh, normals, photo, camera, few, config))
        # Strangers are found among colours of one exposure, painted so or not.
        evened = exposure_gains(
            [log_colours(one) for one in colours], choose_pairs(mesh, photos, cameras)
        )
        if config.even_exposure:
            gains = evened
        if looks_for_strangers:
            geometry = few.width, few.corners_px, mesh.vertices, mesh.faces
            places = kernels.points_at(few.index, few.face, *geometry)
            strangers = find_strangers(cameras, places, colours, evened)
        del colours
    sums = TexelSums.zero(len(table.index))
    for i, (photo, camera) in enumerate(zip(photos, cameras, strict=True)):
        yield BakingStep(f"Painting {photo.name}", 0.4 + 0.45 * i / n)
        if strangers:
            photo = strangers[i].taken_from(photo)
        fitted = fitted_photo(photo, camera, mesh, table)
        prepared = find_usable_area(mesh, fitted, camera, config.margin, config.feather)
        blend_photo(mesh, normals, prepared, gains[i], i, table, config, sums)

    seen = sums.photo >= 0
    if not seen.any():
        raise InputError(
            f"No photo sees {mesh.name}, so there is nothing to paint: 0 % of the surface "
            f"is seen. {why_unseen(mesh, cameras)}"
        )
    yield BakingStep("Filling what no photo sees", 0.85)
    texture = np.zeros((height * width, 3), dtype=np.uint8)
    texture[:] = config.unseen_colour
    photo_index = np.full(height * width, -2, dtype=np.int16)
    quality = np.zeros(height * width, dtype=np.uint8)
    kernels.write_texels(
        table.index,
        table.inside,
        sums.colours,
        sums.photo,
        sums.quality,
        texture,
        photo_index,
        quality,
    )
    if config.unseen == "own":
        _keep_own_colours(mesh, table, seen, texture)
    elif config.unseen == "diffuse" and not seen.all():
        _fill_unseen(mesh, table, seen, texture)
    shares = _area_shares(mesh, table, sums.photo, n)
    yield TexturedMesh(
        mesh=mesh,
        atlas=atlas,
        texture=_with_gutter(texture.reshape(height, width, 3), table),
        photo_index=photo_index.reshape(height, width),
        quality=quality.reshape(height, width),
        seen_share=float(shares.sum()),
        seen_share_by_photo=tuple(float(share) for share in shares),
        gains=gains,
        left_out_share_by_photo=tuple(one.share for one in strangers) or (0.0,) * n,
        config=config,
    )


def _check_own_colours(mesh: Mesh, config: TextureConfig) -> None:
    if config.unseen == "own" and not (
        mesh.own_texture is not None or mesh.vertex_colours is not None
    ):
        raise InputError(
            f"{mesh.name} has neither a texture nor colours at its vertices, so unseen "
            "faces cannot keep their own; choose diffuse, or one colour."
        )


def _keep_own_colours(
    mesh: Mesh, table: TexelTable, seen: np.ndarray, texture: np.ndarray
) -> None:
    """Gives unseen texels the mesh's own texture, or else its vertices' colours."""
    index, face = table.index[~seen], table.face[~seen]
    geometry = table.width, table.corners_px
    if mesh.own_texture is None or mesh.corner_uv is None:
        assert mesh.vertex_colours is not None
        colours = mesh.vertex_colours.astype(np.float64)
        kernels.write_from_vertices(
            index, face, *geometry, mesh.faces, colours, texture
        )
        return
    # Texture coordinates are laid over the faces as positions are.
    uv = np.pad(mesh.corner_uv.reshape(-1, 2), ((0, 0), (0, 1)))
    corners = np.arange(len(uv), dtype=np.int32).reshape(-1, 3)
    for start in range(0, len(index), TEXELS_AT_A_TIME):
        part = slice(start, start + TEXELS_AT_A_TIME)
        places = kernels.points_at(index[part], face[part], *geometry, uv, corners)
        # Coordinates beyond [0, 1] repeat the picture.
        colours = kernels.sample(mesh.own_texture, _wrapped(places))
        texture[index[part]] = np.rint(colours).astype(np.uint8)


def _wrapped(uv: np.ndarray) -> np.ndarray:
    return np.where((uv >= 0.0) & (uv <= 1.0), uv, uv - np.floor(uv))


def _check_photos(photos: Sequence[Photo], cameras: Sequence[Camera]) -> None:
    if len(photos) != len(cameras) or len(photos) == 0:
        raise InputError(
            f"Texture baking needs one camera a photo, but got {len(photos)} photos "
            f"and {len(cameras)} cameras."
        )
    for photo, camera in zip(photos, cameras, strict=True):
        if (photo.width, photo.height) != (camera.width, camera.height):
            raise InputError(
                f"{photo.name} is {photo.width}x{photo.height} px, but its camera is "
                f"for {camera.width}x{camera.height} px."
            )


def _pixels_per_unit(mesh: Mesh, cameras: Sequence[Camera]) -> float:
    """Resolution on the surface of the nearest camera: its median over the faces seen.

    Foreshortening is left out: where one photo sees a face at a grazing angle, another
    sees it better.
    """
    centers = mesh.vertices[mesh.faces].mean(axis=1)
    best = np.zeros(len(centers))
    for camera in cameras:
        pixels = camera.project(centers)
        inside = camera.contains(pixels)
        depth = camera.to_camera(centers[inside])[:, 2]
        best[inside] = np.maximum(best[inside], camera.focal_px / depth)
    seen = best > 0.0
    if not seen.any():
        return 0.0
    order = np.argsort(best[seen])
    cumulative = np.cumsum(mesh.face_areas[seen][order])
    middle = min(np.searchsorted(cumulative, 0.5 * cumulative[-1]), seen.sum() - 1)
    return float(best[seen][order][middle])


def _uv_area(atlas: Atlas) -> float:
    """Area of all charts, where the whole texture is 1."""
    a, b, c = np.moveaxis(atlas.uv[atlas.uv_faces], 1, 0)
    ab, ac = b - a, c - a
    return float(0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum())


def _texture_size(
    mesh: Mesh, atlas: Atlas, pixels_per_unit: float, config: TextureConfig
) -> tuple[int, int]:
    longer = config.size
    if longer == "auto":
        n_texels = mesh.area * (TEXELS_A_PIXEL * pixels_per_unit) ** 2
        n_texels /= max(_uv_area(atlas), 1e-6)
        side = np.sqrt(n_texels * max(atlas.aspect, 1.0 / atlas.aspect))
        longer = int(np.clip(64 * np.ceil(side / 64), 256, MAX_SIZE))
    shorter = longer * min(atlas.aspect, 1.0 / atlas.aspect)
    shorter = min(longer, max(MIN_SIZE, int(64 * np.ceil(shorter / 64 - 1e-9))))
    return (longer, shorter) if atlas.aspect >= 1.0 else (shorter, longer)


def _texel_table(mesh: Mesh, atlas: Atlas, width: int, height: int) -> TexelTable:
    face = atlas.faces_at_texels(width, height)
    inside = face >= 0
    for _ in range(GROWN_RINGS):
        face = kernels.grow_faces(face)
    index = np.flatnonzero(face >= 0)
    return TexelTable(
        index,
        face.ravel()[index],
        inside.ravel()[index],
        width,
        atlas.corners_px(width, height),
        float(np.sqrt(_uv_area(atlas) * width * height / mesh.area)),
    )


def _fill_unseen(
    mesh: Mesh, table: TexelTable, seen: np.ndarray, texture: np.ndarray
) -> None:
    """Spreads the colours of seen vertices over the surface, across all charts."""
    faces = mesh.position_index[mesh.faces]
    n = len(mesh.vertices)
    colours, share = kernels.gather_at_vertices(
        table.index, table.face, seen, table.width, table.corners_px, faces, n, texture
    )
    known = share >= MIN_SEEN_AT_VERTEX
    if not known.any():
        known = share > 0.0
    colours = spread(mesh.vertices, faces, colours, known)
    kernels.write_from_vertices(
        table.index[~seen],
        table.face[~seen],
        table.width,
        table.corners_px,
        faces,
        colours,
        texture,
    )


def _area_shares(
    mesh: Mesh, table: TexelTable, photo: np.ndarray, n_photos: int
) -> Float[np.ndarray, "n"]:
    """Share of the surface's area for which each photo counts most."""
    face, at_texel = table.face[table.inside], photo[table.inside]
    n_texels = np.bincount(face, minlength=len(mesh.faces))
    area = mesh.face_areas / np.maximum(n_texels, 1)
    seen = at_texel >= 0
    sums = np.bincount(at_texel[seen], weights=area[face[seen]], minlength=n_photos)
    # A face too small for a texel shows the one at its middle.
    small = np.flatnonzero(n_texels == 0) if len(table.index) else np.zeros(0, int)
    column, row = np.rint(table.corners_px[small].mean(axis=1)).astype(np.int64).T
    texel = np.clip(column, 0, table.width - 1) + table.width * np.maximum(row, 0)
    at = np.minimum(np.searchsorted(table.index, texel), len(table.index) - 1)
    shown = np.where(table.index[at] == texel, photo[at], -1)
    sums += np.bincount(
        shown[shown >= 0],
        weights=mesh.face_areas[small][shown >= 0],
        minlength=n_photos,
    )
    return sums / mesh.area


def _with_gutter(
    texture: UInt8[np.ndarray, "h w 3"], table: TexelTable
) -> UInt8[np.ndarray, "h w 3"]:
    """The texture with each texel off the charts in the colour of the nearest on them.

    Mipmaps and compression reach far beyond a chart's border.
    """
    empty = np.ones(texture.shape[:2], dtype=np.uint8)
    empty.ravel()[table.index] = 0
    if not empty.any():
        return texture
    labels = cv2.distanceTransformWithLabels(
        empty, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )[1]
    kernels.fill_gutter(
        np.asarray(labels, dtype=np.int32).ravel(),
        table.index,
        empty.ravel() == 0,
        texture.reshape(-1, 3),
    )
    return texture
