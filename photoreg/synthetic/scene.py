"""Scenes with known truth: a mesh, photos of it, true cameras and rough ones."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from photoreg.errors import OutputError
from photoreg.formats.cameras.cameras_json import CameraFile, dump_cameras
from photoreg.formats.mark import marked_picture
from photoreg.formats.models.ply import ply_bytes
from photoreg.formats.writing import Content, write_files
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.ray_hits import Hits
from photoreg.imaging.photo import Photo
from photoreg.synthetic.noise import SolidNoise
from photoreg.synthetic.options import SceneOptions as SceneOptions
from photoreg.synthetic.options import SceneSettings
from photoreg.synthetic.render import (
    Backdrop,
    Shade,
    decode_srgb,
    encode_srgb,
    render_linear,
    sky_and_key_light,
)
from photoreg.synthetic.rock import rock_albedo
from photoreg.synthetic.rough_cameras import rough_start as rough_start
from photoreg.synthetic.scan_errors import scanned
from photoreg.synthetic.sensor import (
    behind_leaves,
    decode_photo,
    encode_photo,
    expose,
    hazy,
    occluded,
)
from photoreg.synthetic.worlds import UP, World, cropped_views, make_views, make_world


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
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
    world = make_world(options)
    views = make_views(world, options)
    cameras = cropped_views(world, views, options)
    shades = _shades(world, cameras, settings)
    if settings.gloss > 0.0:
        shades = tuple(
            _glossy(shade, camera, settings.gloss)
            for shade, camera in zip(shades, cameras, strict=True)
        )
    backdrop = _backdrop(world.mesh, options.seed, settings)
    encoded: dict[str, bytes] = {}
    photos = []
    for index, camera in enumerate(cameras):
        linear = render_linear(world.mesh, camera, shades[index], backdrop)
        if index == len(cameras) - 1 and settings.occluder_share > 0.0:
            linear = occluded(linear, settings.occluder_share, options.seed)
        if index == len(cameras) - 1 and settings.foliage_share > 0.0:
            linear = behind_leaves(linear, settings.foliage_share, options.seed)
        if settings.haze > 0.0:
            linear = hazy(linear, settings.haze, [options.seed, index])
        pixels = expose(linear, index, options.seed, settings)
        stem = f"{options.kind}-{index + 1}"
        if options.n_photos == 2:
            stem = f"{options.kind}-{('left', 'right')[index]}"
        name, data = encode_photo(pixels, stem, settings.jpeg_quality)
        encoded[name] = data
        photos.append(Photo(name, decode_photo(data)))
    return Scene(
        name=options.kind,
        mesh=scanned(world.mesh, settings, options.seed),
        photos=tuple(photos),
        cameras=cameras,
        rough_cameras=tuple(
            rough_start(
                world.mesh,
                [camera.pinhole for camera in views],
                options.error_px,
                options.seed,
            )
        ),
        true_mesh=world.mesh,
        albedo=world.albedo,
        shades=shades,
        backdrop=backdrop,
        encoded=encoded,
    )


def demo_scene() -> Scene:
    """The shell that the program opens with; static/demo holds its files."""
    return make_scene(SceneOptions(kind="shell", seed=0))


def write_scene(
    scene: Scene, folder: Path | str, overwrite: bool = False
) -> list[Path]:
    """Writes mesh, photos, cameras.json (truth) and rough.json; returns the files.

    The folder is made if it does not exist.

    Args:
        scene: The scene.
        folder: Where to.
        overwrite: Whether files without photoreg's mark may be replaced.

    Raises:
        OutputError: if the folder cannot be made or written, or other files are there.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot write the scene to {folder}: {error.strerror or error}."
        ) from error
    contents: dict[Path, Content] = {folder / scene.mesh.name: ply_bytes(scene.mesh)}
    for name, data in scene.encoded.items():
        contents[folder / name] = marked_picture(data)
    names = [photo.name for photo in scene.photos]
    sets = {"cameras.json": scene.cameras, "rough.json": scene.rough_cameras}
    for name, cameras in sets.items():
        file = CameraFile(dict(zip(names, cameras, strict=True)))
        contents[folder / name] = dump_cameras(file)
    return write_files(contents, overwrite=overwrite)


def _shades(
    world: World, cameras: tuple[Camera, ...], settings: SceneSettings
) -> tuple[Shade, ...]:
    if settings.light == "flat":
        return (lambda hits: world.albedo(hits.points),) * len(cameras)
    shades: list[Shade] = []
    for index, camera in enumerate(cameras):
        if index > 0 and settings.light == "same":
            shades.append(shades[0])
            continue
        right, down, forward = camera.R_cam_world
        if settings.light == "same":
            # Up and to the left of the first photo, beside a bright sky.
            key, share = -0.75 * right - 0.85 * down - 0.7 * forward, 0.6
        else:
            # On the other side in each photo, and so strong that little stays in place.
            side = -1.0 if index % 2 == 0 else 1.0
            key, share = side * right - 0.6 * down - 0.6 * forward, 0.85
        light = sky_and_key_light(
            world.mesh, UP, key, share, key_spread=0.2, normals=world.normals
        )
        shades.append(_lit(world, world.exposure * light))
    return tuple(shades)


def _glossy(shade: Shade, camera: Camera, gloss: float) -> Shade:
    """With the highlight of a lamp above and beside the camera (Blinn's model)."""
    right, down, forward = camera.R_cam_world
    to_lamp = -(0.6 * right + 0.8 * down + forward)
    to_lamp /= np.linalg.norm(to_lamp)

    def glossy(hits: Hits) -> Float[np.ndarray, "n 3"]:
        half = to_lamp - hits.directions
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        cosine = np.clip(np.einsum("nd,nd->n", hits.normals, half), 0.0, 1.0)
        return shade(hits) + gloss * (cosine**20)[:, None]

    return glossy


def _lit(world: World, light: Float[np.ndarray, "n"]) -> Shade:
    def shade(hits: Hits) -> Float[np.ndarray, "n 3"]:
        corners = light[world.mesh.faces[hits.face]]
        received = np.einsum("nc,nc->n", hits.weights, corners)
        return world.albedo(hits.points) * received[:, None]

    return shade


def _backdrop(mesh: Mesh, seed: int, settings: SceneSettings) -> Backdrop:
    if settings.background == "dark":
        colour = np.full(3, decode_srgb(np.array(18.0)))
        return lambda _, pixels: np.broadcast_to(colour, (len(pixels), 3))
    if settings.background == "plain":
        return _soft_grey
    center, radius = mesh.bounds.mean(axis=0), 1.5 * mesh.diagonal
    noise = SolidNoise(seed + 1)

    def surroundings(camera: Camera, pixels: np.ndarray) -> np.ndarray:
        # The far side of a painted sphere: it moves behind the object as a room does.
        origin, rays = camera.rays(pixels)
        along = rays @ (center - origin)
        apart = np.sum((center - origin) ** 2) - along**2
        reach = along + np.sqrt(np.maximum(radius**2 - apart, 0.0))
        places = (origin + reach[:, None] * rays - center) * (3.6 / mesh.diagonal)
        return rock_albedo(places, noise)

    return surroundings


def _soft_grey(camera: Camera, pixels: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """A slate backdrop, lightest behind the object's upper half."""
    middle = np.array([0.5 * camera.width, 0.42 * camera.height])
    offsets = (pixels - middle) / camera.width
    fall = 1.0 - 1.1 * np.einsum("nd,nd->n", offsets, offsets)
    return fall[:, None] * np.array([0.085, 0.094, 0.106])
