"""Scenes with known truth: a mesh, photos of it, true cameras and rough ones."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from photoreg.camera import Camera
from photoreg.errors import OutputError
from photoreg.formats.cameras_json import CameraFile, save_cameras
from photoreg.mesh import Mesh
from photoreg.noise import SolidNoise
from photoreg.photo import Photo
from photoreg.render import (
    Backdrop,
    Hits,
    Shade,
    decode_srgb,
    encode_srgb,
    render_linear,
    sky_and_key_light,
)
from photoreg.rock import rock_albedo, rock_mesh
from photoreg.rough import rough_start as rough_start
from photoreg.scene_options import SceneOptions as SceneOptions
from photoreg.scene_options import SceneSettings

UP = np.array([0.0, 0.0, 1.0])
"""Upwards in the scenes' world."""


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A mesh and photos of it, with the truth that only a made scene can tell."""

    name: str
    """Short name, for folders and messages."""
    mesh: Mesh
    """The mesh that a registration is given."""
    photos: tuple[Photo, ...]
    """The photos that a registration is given."""
    cameras: tuple[Camera, ...]
    """The true camera of each photo."""
    rough_cameras: tuple[Camera, ...]
    """The rough camera of each photo, where a registration starts."""
    true_mesh: Mesh
    """The surface that the photos show: ``mesh`` without its errors."""
    albedo: Callable[[np.ndarray], np.ndarray]
    """Surface colour at points (n, 3) of the true surface, linear RGB (n, 3)."""
    shades: tuple[Shade, ...]
    """Light that leaves the surface, as each photo was lit."""
    backdrop: Backdrop
    """Light from behind the object."""
    encoded: Mapping[str, bytes]
    """The photos as files, by name; ``photos`` are decoded from these."""

    def render(self, camera: Camera, lit_as: int = 0) -> UInt8[np.ndarray, "h w 3"]:
        """What a perfect ``camera`` would see, sRGB: no noise, no exposure, no JPEG.

        Args:
            camera: where from; any size.
            lit_as: the photo whose light is used.
        """
        linear = render_linear(
            self.true_mesh, camera, self.shades[lit_as], self.backdrop
        )
        return np.rint(encode_srgb(linear)).astype(np.uint8)


def make_scene(options: SceneOptions) -> Scene:
    """Makes the scene that ``options`` describe; the same options, the same scene."""
    settings = options.settings()
    noise = SolidNoise(options.seed)
    subdivisions = max(0, round(np.log(options.n_faces / 20.0) / np.log(4.0)))
    true_mesh = rock_mesh(options.seed, subdivisions)

    def albedo(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        return rock_albedo(points, noise, settings.contrast)

    cameras = _rock_views(true_mesh, options, settings)
    shades = _shades(true_mesh, albedo, cameras, settings)
    names = [f"{options.kind}-{number}" for number in range(1, options.n_photos + 1)]
    return _photographed(
        options,
        true_mesh,
        albedo,
        cameras,
        shades,
        _backdrop(true_mesh, options),
        names,
    )


def _photographed(
    options: SceneOptions,
    true_mesh: Mesh,
    albedo: Callable[[np.ndarray], np.ndarray],
    cameras: tuple[Camera, ...],
    shades: tuple[Shade, ...],
    backdrop: Backdrop,
    names: list[str],
) -> Scene:
    settings = options.settings()
    encoded: dict[str, bytes] = {}
    photos = []
    for index, (camera, shade, stem) in enumerate(
        zip(cameras, shades, names, strict=True)
    ):
        linear = render_linear(true_mesh, camera, shade, backdrop)
        if index == len(cameras) - 1 and settings.occluder_share > 0.0:
            linear = _occluded(linear, settings.occluder_share, options.seed)
        values = _sensor_values(linear, index, options.seed, settings)
        name, data = _encode(values, stem, settings.jpeg_quality)
        encoded[name] = data
        photos.append(Photo(name, _decode(data)))
    mesh = _with_noise(true_mesh, settings.mesh_noise, options.seed)
    return Scene(
        name=options.kind,
        mesh=mesh,
        photos=tuple(photos),
        cameras=cameras,
        rough_cameras=tuple(
            rough_start(true_mesh, cameras, options.error_px, options.seed)
        ),
        true_mesh=true_mesh,
        albedo=albedo,
        shades=shades,
        backdrop=backdrop,
        encoded=encoded,
    )


def write_scene(scene: Scene, folder: Path | str) -> list[Path]:
    """Writes mesh, photos, cameras.json (truth) and rough.json; returns the files.

    Raises:
        OutputError: if the folder cannot be made or written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        mesh_path = folder / scene.mesh.name
        scene.mesh.save(mesh_path)
        written = [mesh_path]
        for name, data in scene.encoded.items():
            written.append(folder / name)
            written[-1].write_bytes(data)
    except OSError as error:
        raise OutputError(
            f"Cannot write the scene to {folder}: {error.strerror or error}."
        ) from error
    photo_names = [photo.name for photo in scene.photos]
    for name, cameras in (
        ("cameras.json", scene.cameras),
        ("rough.json", scene.rough_cameras),
    ):
        written.append(folder / name)
        file = CameraFile(dict(zip(photo_names, cameras, strict=True)))
        save_cameras(written[-1], file)
    return written


def _rock_views(
    mesh: Mesh, options: SceneOptions, settings: SceneSettings
) -> tuple[Camera, ...]:
    rng = np.random.default_rng([options.seed, 0x71E5])
    return tuple(
        _view(
            mesh,
            azimuth_deg=-90.0
            + (index - 0.5 * (options.n_photos - 1)) * settings.baseline_deg,
            elevation_deg=15.0 + 5.0 * (index % 2),
            distance=mesh.diagonal * rng.uniform(1.06, 1.14),
            focal_px=settings.width * rng.uniform(1.155, 1.19),
            settings=settings,
            rng=rng,
        )
        for index in range(options.n_photos)
    )


def _view(
    mesh: Mesh,
    azimuth_deg: float,
    elevation_deg: float,
    distance: float,
    focal_px: float,
    settings: SceneSettings,
    rng: np.random.Generator,
) -> Camera:
    """A camera about the object, a little turned, its principal point off the middle."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    direction = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    target = mesh.bounds.mean(axis=0) + 0.01 * mesh.diagonal * rng.uniform(-1, 1, 3)
    roll = np.radians(rng.uniform(-2.0, 2.0))
    side = np.cross(direction, UP)
    up = np.cos(roll) * UP + np.sin(roll) * side / np.linalg.norm(side)
    camera = Camera.look_at(
        mesh.bounds.mean(axis=0) + distance * direction,
        target,
        up,
        focal_px,
        settings.width,
        settings.height,
    )
    K = camera.K.copy()
    # About 5 px at 1,024 px width, on either side, never nearly in the middle.
    K[:2, 2] += (
        rng.choice([-1.0, 1.0], 2) * rng.uniform(0.003, 0.006, 2) * settings.width
    )
    return dataclasses.replace(camera, K=K)


def _shades(
    mesh: Mesh,
    albedo: Callable[[np.ndarray], np.ndarray],
    cameras: tuple[Camera, ...],
    settings: SceneSettings,
) -> tuple[Shade, ...]:
    if settings.light == "flat":
        return (lambda hits: albedo(hits.points),) * len(cameras)
    lights = []
    for index, camera in enumerate(cameras):
        # The lamp stands up and to the left of the first photo; a moved one changes
        # sides with each photo.
        right, down, forward = camera.R_cam_world
        if index == 0 or settings.light == "moved":
            side = -1.0 if index % 2 == 0 else 1.0
            key = side * 0.8 * right - 0.5 * down - 0.7 * forward
            lights.append(sky_and_key_light(mesh, UP, key, key_share=0.65, n_rays=64))
        else:
            lights.append(lights[0])
    return tuple(_lit(mesh, albedo, light) for light in lights)


def _lit(
    mesh: Mesh, albedo: Callable[[np.ndarray], np.ndarray], light: np.ndarray
) -> Shade:
    def shade(hits: Hits) -> Float[np.ndarray, "n 3"]:
        received = np.einsum("nc,nc->n", hits.weights, light[mesh.faces[hits.face]])
        return albedo(hits.points) * received[:, None]

    return shade


def _backdrop(mesh: Mesh, options: SceneOptions) -> Backdrop:
    settings = options.settings()
    center, radius = mesh.bounds.mean(axis=0), 1.5 * mesh.diagonal
    noise = SolidNoise(options.seed + 1)

    def dark(_: Camera, pixels: np.ndarray) -> np.ndarray:
        return np.full((len(pixels), 3), decode_srgb(np.array(18.0)))

    def plain(camera: Camera, pixels: np.ndarray) -> np.ndarray:
        middle = np.array([0.5 * camera.width, 0.42 * camera.height])
        offsets = (pixels - middle) / camera.width
        fall = 1.0 - 1.1 * np.einsum("nd,nd->n", offsets, offsets)
        return fall[:, None] * np.array([0.105, 0.115, 0.13])

    def clutter(camera: Camera, pixels: np.ndarray) -> np.ndarray:
        # The far side of a painted sphere about the object: it moves as surroundings do.
        origin, rays = camera.rays(pixels)
        along = rays @ (center - origin)
        apart = np.sum((center - origin) ** 2) - along**2
        reach = along + np.sqrt(np.maximum(radius**2 - apart, 0.0))
        return rock_albedo(
            (origin + reach[:, None] * rays) / mesh.diagonal * 3.6, noise
        )

    return {"dark": dark, "plain": plain, "clutter": clutter}[settings.background]


def _occluded(linear: np.ndarray, share: float, seed: int) -> np.ndarray:
    """The picture with ``share`` of it hidden by a round thing that leans in."""
    rng = np.random.default_rng([seed, 0x0CC1])
    height, width = linear.shape[:2]
    grid_x, grid_y = np.meshgrid(np.arange(width), np.arange(height))
    anchor_x = rng.choice([-0.02, 1.02]) * width
    anchor_y = rng.uniform(0.35, 0.75) * height
    places = np.column_stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)])
    noise = SolidNoise(seed + 2)
    wobble = noise(places, 4.0 / width, octaves=2)[:, 0].reshape(height, width)
    reach = np.hypot(grid_x - anchor_x, grid_y - anchor_y) + 0.03 * width * wobble
    # The level that exactly the share lies under; a pixel's width of soft edge.
    cover = np.clip(np.quantile(reach, share) - reach + 0.5, 0.0, 1.0)[:, :, None]
    grain = noise(places, 30.0 / width, octaves=4)[:, 1].reshape(height, width, 1)
    colour = np.array([0.16, 0.21, 0.12]) * (1.0 + 0.25 * grain)
    return (cover * colour + (1.0 - cover) * linear).astype(np.float32)


def _sensor_values(
    linear: np.ndarray, index: int, seed: int, settings: SceneSettings
) -> UInt8[np.ndarray, "h w 3"]:
    """Pixel bytes: the lens darkens corners, then gain and offset, then noise."""
    height, width = linear.shape[:2]
    if settings.vignetting > 0.0:
        x = (np.arange(width) - 0.5 * (width - 1)) / (0.5 * np.hypot(width, height))
        y = (np.arange(height) - 0.5 * (height - 1)) / (0.5 * np.hypot(width, height))
        squared = y[:, None] ** 2 + x[None, :] ** 2
        linear = linear * (1.0 - settings.vignetting * squared)[:, :, None]
    values = encode_srgb(linear)
    if index > 0:
        values = values * np.asarray(settings.gain) + np.asarray(settings.offset)
    if settings.sensor_noise > 0.0:
        rng = np.random.default_rng([seed, 0x5E45, index])
        values = values + settings.sensor_noise * rng.standard_normal(
            values.shape, dtype=np.float32
        )
    return np.rint(np.clip(values, 0.0, 255.0)).astype(np.uint8)


def _encode(
    values: UInt8[np.ndarray, "h w 3"], stem: str, jpeg_quality: int
) -> tuple[str, bytes]:
    if jpeg_quality > 0:
        name, parameters = f"{stem}.jpg", [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    else:
        name, parameters = f"{stem}.png", [cv2.IMWRITE_PNG_COMPRESSION, 1]
    _, data = cv2.imencode(Path(name).suffix, values[:, :, ::-1], parameters)
    return name, data.tobytes()


def _decode(data: bytes) -> UInt8[np.ndarray, "h w 3"]:
    decoded = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None  # It was encoded here.
    return np.ascontiguousarray(decoded[:, :, ::-1])


def _with_noise(mesh: Mesh, fraction: float, seed: int) -> Mesh:
    """The mesh with each vertex off along its normal by ``fraction`` of the diagonal."""
    if fraction == 0.0:
        return mesh
    rng = np.random.default_rng([seed, 0x3E54])
    errors = fraction * mesh.diagonal * rng.standard_normal(len(mesh.vertices))
    return dataclasses.replace(
        mesh, vertices=mesh.vertices + errors[:, None] * mesh.vertex_normals
    )
