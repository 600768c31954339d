"""The objects that synthetic scenes show, their colours, and cameras about them."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.geometry.mesh import Mesh
from photoreg.synthetic.isosurface import gradient
from photoreg.synthetic.noise import SolidNoise
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.rock import rock_albedo, rock_mesh
from photoreg.synthetic.shell import ShellForm, shell_field, shell_surface
from photoreg.synthetic.shell_pattern import PATTERNS, shell_albedo

UP = np.array([0.0, 0.0, 1.0])
"""Upwards in the scenes' world."""
FRONT_DEG = -90.0
"""Azimuth that the middle photo is taken from."""
RISE_DEG = 22.0
"""How much higher the cameras of a second turn about the object stand, and of a third;
a fourth begins below again."""
SHELL_HEIGHT_MM = 90.0
SHELL_CENTER_MM = np.array([38.0, -21.0, 64.0])
SHELL_FACING_DEG = -40.0
"""Azimuth, in the shell's own axes, of the side that is turned to the front."""
SHELL_TILT_DEG = 38.0
"""How far the shell's axis leans to the right, seen from the front."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """An object with a solid texture, and how it likes to be photographed."""

    mesh: Mesh
    """The true surface."""
    albedo: Callable[[np.ndarray], np.ndarray]
    """Linear RGB (n, 3) at points (n, 3) of the surface."""
    normals: Float[np.ndarray, "n 3"]
    """Unit normals of the vertices, as true as they are known, for the light."""
    focal_share: float
    """Focal length over the photo's width."""
    fill: float
    """Share of the photo's width or height that the object fills."""
    elevations_deg: tuple[float, float]
    """Heights of the cameras, in turn."""
    exposure: float
    """Factor on the light."""


def make_world(options: SceneOptions) -> World:
    """The object of ``options``; the same seed gives the same object for every kind."""
    return _shell(options) if options.kind == "shell" else _rock(options)


def _rock(options: SceneOptions) -> World:
    contrast = options.settings().contrast
    subdivisions = max(0, round(np.log(options.n_faces / 20.0) / np.log(4.0)))
    mesh = _storable(rock_mesh(options.seed, subdivisions))
    noise = SolidNoise(options.seed)
    return World(
        mesh=mesh,
        albedo=lambda points: rock_albedo(points, noise, contrast),
        normals=mesh.vertex_normals,
        focal_share=1.17,
        fill=0.76,
        elevations_deg=(15.0, 20.0),
        exposure=1.2,
    )


def _shell(options: SceneOptions) -> World:
    contrast = options.settings().contrast
    form, pattern = _shell_form(options.seed), PATTERNS[options.seed % len(PATTERNS)]
    vertices, faces = shell_surface(form, options.n_faces)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    scale = SHELL_HEIGHT_MM / np.ptp(vertices[:, 2])
    R_world_shell = (
        Rotation.from_euler("y", SHELL_TILT_DEG, degrees=True)
        * Rotation.from_euler("z", FRONT_DEG - SHELL_FACING_DEG, degrees=True)
    ).as_matrix()

    def to_shell(points: np.ndarray) -> np.ndarray:
        return (points - SHELL_CENTER_MM) @ R_world_shell / scale + middle

    world = (vertices - middle) @ R_world_shell.T * scale + SHELL_CENTER_MM
    mesh = _storable(Mesh(world, faces, name="shell.ply"))
    slope = gradient(
        lambda points: shell_field(points, form), to_shell(mesh.vertices), 0.01
    )
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    noise = SolidNoise(options.seed + 4)
    return World(
        mesh=mesh,
        albedo=lambda points: shell_albedo(
            to_shell(points), form, pattern, noise, contrast
        ),
        normals=slope @ R_world_shell.T,
        focal_share=2.3,
        fill=0.88,
        elevations_deg=(7.0, 10.0),
        exposure=1.15,
    )


def _shell_form(seed: int) -> ShellForm:
    """The demo's form for seed 0; every other seed grows a little differently."""
    form = ShellForm()
    if seed == 0:
        return form
    rng = np.random.default_rng([seed, 0x54E1])
    return dataclasses.replace(
        form,
        growth=form.growth * rng.uniform(0.97, 1.04),
        drop=form.drop * rng.uniform(0.9, 1.12),
        below=form.below * rng.uniform(0.9, 1.1),
        ribs=float(rng.integers(9, 18)),
        rib_height=form.rib_height * rng.uniform(0.5, 1.2),
        cord_height=form.cord_height * rng.uniform(0.5, 1.3),
        flare=form.flare * rng.uniform(0.6, 1.4),
    )


def _storable(mesh: Mesh) -> Mesh:
    """The mesh as a file of single precision holds it, so that a file loses nothing."""
    return dataclasses.replace(
        mesh, vertices=mesh.vertices.astype(np.float32).astype(np.float64)
    )


def make_views(world: World, options: SceneOptions) -> tuple[Camera, ...]:
    """True cameras about the object, neighbours ``baseline_deg`` apart.

    Nothing is regular: distances, focal lengths, aims and turns vary a little, and
    principal points are about 5 px (at 1,024 px width) off the middle.
    """
    baseline_deg = options.settings().baseline_deg
    rng = np.random.default_rng([options.seed, 0x71E5])
    return tuple(
        _view(
            world,
            options,
            azimuth_deg=FRONT_DEG
            + (index - 0.5 * (options.n_photos - 1)) * baseline_deg,
            elevation_deg=world.elevations_deg[index % 2]
            + RISE_DEG * (int(index * baseline_deg / 360.0) % 3),
            rng=rng,
        )
        for index in range(options.n_photos)
    )


def cropped_views(
    world: World, cameras: Sequence[Camera], options: SceneOptions
) -> tuple[Camera, ...]:
    """The cameras of photos that show the same, but are parts of larger ones.

    Each principal point is off by ``options.crop`` to a side of its own, and the camera
    turned so that the object's middle stays in its place.
    """
    if options.crop == 0.0:
        return tuple(cameras)
    rng = np.random.default_rng([options.seed, 0xC409])
    middle = world.mesh.bounds.mean(axis=0)
    return tuple(
        _cropped(camera, middle, options.crop, rng.uniform(0.0, 2.0 * np.pi))
        for camera in cameras
    )


def _cropped(
    camera: Camera, middle: np.ndarray, share: float, side_rad: float
) -> Camera:
    size = np.array([camera.width, camera.height])
    K = camera.K.copy()
    K[:2, 2] += share * size * [np.cos(side_rad), np.sin(side_rad)]
    pixel = camera.pinhole.project(middle[None])[0]
    rays = [np.linalg.solve(k, [*pixel, 1.0]) for k in (camera.K, K)]
    before, after = (ray / np.linalg.norm(ray) for ray in rays)
    # Both are less than a right angle apart.
    axis = np.cross(before, after)
    turn = Rotation.from_rotvec(
        axis * np.arcsin(np.linalg.norm(axis)) / max(np.linalg.norm(axis), 1e-300)
    ).as_matrix()
    return dataclasses.replace(
        camera,
        K=K,
        R_cam_world=turn @ camera.R_cam_world,
        t_cam_world=turn @ camera.t_cam_world,
    )


def _view(
    world: World,
    options: SceneOptions,
    azimuth_deg: float,
    elevation_deg: float,
    rng: np.random.Generator,
) -> Camera:
    settings, mesh = options.settings(), world.mesh
    width, height = settings.width, settings.height
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    direction = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    middle = mesh.bounds.mean(axis=0)
    roll = np.radians(rng.uniform(-2.0, 2.0))
    side = np.cross(direction, UP)
    up = np.cos(roll) * UP + np.sin(roll) * side / np.linalg.norm(side)
    focal_share = settings.focal_share or world.focal_share
    focal_px = focal_share * width * rng.uniform(0.985, 1.015)
    distance = focal_share * mesh.diagonal
    aim = width * rng.uniform(-0.012, 0.012, 2)
    fill = world.fill * rng.uniform(0.97, 1.03)
    target = middle

    def looking() -> Camera:
        return Camera.look_at(
            middle + distance * direction, target, up, focal_px, width, height
        )

    for _ in range(3):
        # Look at the middle of what is seen, from where it fills the photo.
        camera = looking()
        pixels = camera.project(mesh.vertices)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        distance *= max((high - low) / (fill * np.array([width, height])))
        shift = 0.5 * (low + high) - camera.K[:2, 2]
        target = target + shift @ camera.R_cam_world[:2] * distance / focal_px
    target = target + aim @ looking().R_cam_world[:2] * distance / focal_px
    camera = looking()
    K = camera.K.copy()
    K[:2, 2] += rng.choice([-1.0, 1.0], 2) * rng.uniform(0.003, 0.006, 2) * width
    return dataclasses.replace(camera, K=K, lens=Lens(*options.distortion))
