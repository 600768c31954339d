"""A textured model as a camera sees it that took no photo, and how true that is."""

import dataclasses

import numpy as np
from skimage.metrics import structural_similarity

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.ray_hits import Hits
from photoreg.synthetic.render import decode_srgb, encode_srgb, render_linear
from photoreg.synthetic.scene import Scene
from photoreg.texture.bake import TexturedMesh


@dataclasses.dataclass(frozen=True)
class Likeness:
    """How like two pictures are where the model is painted."""

    psnr_db: float
    ssim: float
    n_pixels: int
    """Pixels compared."""


def third_camera(scene: Scene, way: float) -> Camera:
    """A camera that took no photo, from the left one (``way`` 0) to the right one (1)."""
    left, right = scene.cameras
    center = (1.0 - way) * left.center + way * right.center
    center = center + 0.03 * scene.mesh.diagonal * left.R_cam_world[1]
    return Camera.look_at(
        center, scene.mesh.centroid, [0, 0, 1], left.focal_px, left.width, left.height
    )


def bilinear(picture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Colours (n, channels) at texture coordinates (n, 2), v upwards, as viewers do."""
    height, width = picture.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip((1.0 - uv[:, 1]) * height - 0.5, 0, height - 1)
    ix = np.minimum(x.astype(int), width - 2)
    iy = np.minimum(y.astype(int), height - 2)
    fx, fy = (x - ix)[:, None], (y - iy)[:, None]
    upper = (1 - fx) * picture[iy, ix] + fx * picture[iy, ix + 1]
    lower = (1 - fx) * picture[iy + 1, ix] + fx * picture[iy + 1, ix + 1]
    return (1 - fy) * upper + fy * lower


def photograph_texture(
    mesh: Mesh, corner_uv: np.ndarray, texture: np.ndarray, camera: Camera
) -> np.ndarray:
    """The textured surface before black, anti-aliased, (h, w, 3) sRGB in 0 ... 255."""

    def shade(hits: Hits) -> np.ndarray:
        uv = (hits.weights[:, :, None] * corner_uv[hits.face]).sum(axis=1)
        return decode_srgb(bilinear(texture, uv))

    return encode_srgb(render_linear(mesh, camera, shade, _black))


def painted_pixels(textured: TexturedMesh, camera: Camera) -> np.ndarray:
    """Pixels (h, w) that show nothing but texels which a photo paints."""
    seen = (textured.photo_index >= 0)[:, :, None].astype(np.float64)

    def shade(hits: Hits) -> np.ndarray:
        uv = (hits.weights[:, :, None] * textured.corner_uv[hits.face]).sum(axis=1)
        return np.repeat(bilinear(seen, uv), 3, axis=1)

    return render_linear(textured.mesh, camera, shade, _black)[:, :, 0] > 1.0 - 1e-5


def likeness(
    textured: TexturedMesh,
    camera: Camera,
    truth: np.ndarray,
    own_exposure: bool = False,
) -> Likeness:
    """Compares the model, as ``camera`` sees it, with the truth (h, w, 3) in bytes.

    Args:
        textured: The model.
        camera: One that took none of its photos.
        truth: What that camera saw.
        own_exposure: Whether the truth is a photo with an exposure of its own. A texture
            has the mean exposure of the photos it is made of and cannot know that of
            another: one gain by channel, the median ratio, is then taken out. On a real
            set (granite) the photos between two others were 7 % brighter, which alone
            is 3 dB.
    """
    picture = photograph_texture(
        textured.mesh, textured.corner_uv, textured.texture, camera
    )
    shown = painted_pixels(textured, camera)
    if own_exposure:
        ratio = (truth[shown] + 1.0) / (picture[shown] + 1.0)
        picture = np.clip(picture * np.median(ratio, axis=0), 0.0, 255.0)
    squares = (picture - truth)[shown] ** 2
    similarity: np.ndarray = structural_similarity(
        picture,
        truth.astype(np.float64),
        channel_axis=2,
        data_range=255.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )[1]  # pyright: ignore[reportAssignmentType]
    # SSIM looks 5 px around: only where all of that is painted.
    inner = _eroded(shown, 5)
    return Likeness(
        float(10.0 * np.log10(255.0**2 / np.mean(squares))),
        float(similarity[inner].mean()),
        int(shown.sum()),
    )


def _eroded(mask: np.ndarray, radius: int) -> np.ndarray:
    padded = np.pad(mask, radius)
    views = np.lib.stride_tricks.sliding_window_view(padded, (2 * radius + 1,) * 2)
    return np.asarray(views.all(axis=(2, 3)))


def _black(_: Camera, pixels: np.ndarray) -> np.ndarray:
    return np.zeros((len(pixels), 3))
