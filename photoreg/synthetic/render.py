"""Photographs of a known surface by ray casting: anti-aliased, in linear light."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.ray_hits import Hits, surface_hits

BAND_RAYS = 400_000
"""Rays cast at a time: bounds the memory."""

Shade = Callable[[Hits], np.ndarray]
"""Linear RGB (n, 3) that leaves the surface towards the camera."""
Backdrop = Callable[[Camera, np.ndarray], np.ndarray]
"""Linear RGB (n, 3) behind the object, at pixels (n, 2) of a camera."""


def render_linear(
    mesh: Mesh, camera: Camera, shade: Shade, backdrop: Backdrop, supersampling: int = 3
) -> Float[np.ndarray, "h w 3"]:
    """What ``camera`` sees, linear RGB float32: each pixel is the mean over its square.

    Pixel (x, y) is the square of one pixel around (x, y), sampled at
    ``supersampling`` squared places. Pixels whose centre and eight neighbours all
    miss the object are backdrop; only the others are supersampled.
    """
    width, height = camera.width, camera.height
    grid_x, grid_y = np.meshgrid(np.arange(width), np.arange(height))
    centers = np.column_stack([grid_x.ravel(), grid_y.ravel()]).astype(np.float64)
    image = np.asarray(backdrop(camera, centers), dtype=np.float32)
    origin, directions = camera.rays(centers)
    face, _ = mesh.first_hits(np.broadcast_to(origin, directions.shape), directions)
    near = np.pad((face >= 0).reshape(height, width), 1)
    near = near[:-2] | near[1:-1] | near[2:]
    near = (near[:, :-2] | near[:, 1:-1] | near[:, 2:]).ravel()
    steps = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    pixels = np.flatnonzero(near)
    band = max(1, BAND_RAYS // len(offsets))
    for start in range(0, len(pixels), band):
        chosen = pixels[start : start + band]
        places = (centers[chosen, None, :] + offsets).reshape(-1, 2)
        _, directions = camera.rays(places)
        met, hits = surface_hits(mesh, origin, directions)
        colours = np.zeros((len(places), 3), dtype=np.float32)
        colours[met] = shade(hits)
        if not met.all():
            colours[~met] = backdrop(camera, places[~met])
        image[chosen] = colours.reshape(len(chosen), len(offsets), 3).mean(axis=1)
    return image.reshape(height, width, 3)


def sky_and_key_light(
    mesh: Mesh,
    up: Float[np.ndarray, "3"],
    key_direction: Float[np.ndarray, "3"],
    key_share: float = 0.5,
    key_spread: float = 0.15,
    n_rays: int = 128,
    normals: Float[np.ndarray, "n 3"] | None = None,
) -> Float[np.ndarray, "n"]:
    """Light that falls on each vertex: a soft sky and a lamp, both with shadows by rays.

    Args:
        mesh: the surface, which also casts the shadows.
        up: where the sky is brightest; below it is half as bright.
        key_direction: towards the lamp, far away.
        key_share: the lamp's share of the light on a surface that faces it.
        key_spread: the lamp's radius over its distance: larger is softer.
        n_rays: rays a vertex for the sky; a quarter of it for the lamp.
        normals: unit normals of the vertices, if better ones are known than the mesh's.

    Returns:
        Light by vertex: 1 where nothing is hidden and the surface faces both.
    """
    # All vertices share the directions: no noise between neighbours.
    rng = np.random.default_rng(0)
    up, key = up / np.linalg.norm(up), key_direction / np.linalg.norm(key_direction)
    if normals is None:
        normals = mesh.vertex_normals
    origins = mesh.vertices + 1e-3 * mesh.diagonal * normals
    sky = _even_directions(n_rays, rng)
    brightness = 0.75 + 0.25 * sky @ up
    received, possible = np.zeros(len(origins)), np.zeros(len(origins))
    for direction, bright in zip(sky, brightness, strict=True):
        cosine = normals @ direction
        facing = np.flatnonzero(cosine > 0.0)
        rays = np.broadcast_to(direction, (len(facing), 3))
        free = mesh.first_hits(origins[facing], rays)[0] < 0
        received[facing[free]] += bright * cosine[facing[free]]
        possible[facing] += cosine[facing]
    sky_light = received / np.maximum(possible, 1e-12)
    lamp = np.zeros(len(origins))
    n_lamp = max(1, n_rays // 4)
    for direction in key + key_spread * _even_directions(n_lamp, rng):
        direction = direction / np.linalg.norm(direction)
        cosine = normals @ direction
        facing = np.flatnonzero(cosine > 0.0)
        rays = np.broadcast_to(direction, (len(facing), 3))
        free = mesh.first_hits(origins[facing], rays)[0] < 0
        lamp[facing[free]] += cosine[facing[free]] / n_lamp
    return (1.0 - key_share) * sky_light + key_share * lamp


def _even_directions(n: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Unit directions spread evenly over the sphere (a Fibonacci spiral), turned."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(n)
    radius = np.sqrt(1.0 - z**2)
    spiral = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    return spiral @ np.linalg.qr(rng.normal(size=(3, 3)))[0]


def encode_srgb(linear: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Linear light 0..1 to sRGB values 0..255, not rounded (IEC 61966-2-1)."""
    linear = np.clip(linear, 0.0, 1.0)
    curved = 1.055 * np.power(linear, 1.0 / 2.4) - 0.055
    return 255.0 * np.where(linear <= 0.0031308, 12.92 * linear, curved)


def decode_srgb(encoded: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """SRGB values 0..255 to linear light 0..1."""
    values = np.asarray(encoded, dtype=np.float64) / 255.0
    return np.where(
        values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4
    )
