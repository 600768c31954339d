"""What a synthetic scene is made of: the options, and what each kind stands for."""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from photoreg.errors import InputError
from photoreg.geometry.lens import Lens

SceneKind = Literal["shell", "clean", "mid", "clutter", "hard"]
Background = Literal["dark", "plain", "clutter"]
Light = Literal["flat", "same", "moved"]
PerChannel = float | tuple[float, float, float]

_MID = {
    "baseline_deg": 30.0,
    "contrast": 0.3,
    "sensor_noise": 3.0,
    "gain": 0.85,
    "mesh_noise": 0.001,
}
KIND_SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "shell": {
        "light": "same",
        "background": "plain",
        "width": 1280,
        "height": 960,
        "jpeg_quality": 92,
        "sensor_noise": 1.0,
    },
    "clean": {"sensor_noise": 1.5},
    "mid": _MID,
    "clutter": {**_MID, "background": "clutter"},
    "hard": {**_MID, "contrast": 0.2, "gain": 0.8, "light": "moved"},
}
"""What each kind of scene sets apart from the defaults of `SceneSettings`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """The settings of `SceneOptions` that a kind of scene gives, all decided."""

    width: int = 1024
    height: int = 768
    baseline_deg: float = 25.0
    mesh_noise: float = 0.0
    mesh_noise_length: float = 0.0
    mesh_smoothing: float = 0.0
    mesh_fat_edges: float = 0.0
    mesh_holes: float = 0.0
    contrast: float = 1.0
    gain: PerChannel = 1.0
    offset: PerChannel = 0.0
    vignetting: float = 0.0
    haze: float = 0.0
    gloss: float = 0.0
    sensor_noise: float = 0.0
    jpeg_quality: int = 0
    light: Light = "flat"
    background: Background = "dark"
    occluder_share: float = 0.0
    foliage_share: float = 0.0
    focal_share: float | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """What to make. A setting left at None is as ``kind`` says.

    Raises:
        InputError: at construction, if a setting is not possible.
    """

    kind: SceneKind = "shell"
    """A sea shell, or a bumpy rock: clean, mid (faint texture, noise, exposure, wrong
    mesh), clutter (mid before textured surroundings), hard (light moved)."""
    seed: int = 0
    """Varies pattern, form, views, noise and rough cameras."""
    n_photos: Annotated[int, tyro.conf.arg(name="photos")] = 2
    """Photos, at least 2, each ``baseline_deg`` apart from the one before, around the
    object; once around they go on from higher up."""
    n_faces: int = 20_480
    """Faces of the mesh, about: a rock's are 20 times a power of 4."""
    error_px: tuple[float, float] = (15.0, 25.0)
    """Mean projection error of the rough cameras, lowest and highest, in pixels."""
    width: int | None = None
    """Photo width in pixels."""
    height: int | None = None
    """Photo height in pixels."""
    baseline_deg: float | None = None
    """Angle about the object between neighbouring photos, in degrees."""
    mesh_noise: float | None = None
    """Sigma of the error of each vertex of the given mesh, along its normal, as a
    fraction of the diagonal. Photos always show the true surface."""
    mesh_noise_length: float | None = None
    """How far the mesh's error is alike, as a fraction of the diagonal; 0: each vertex has
    its own."""
    mesh_smoothing: float | None = None
    """How far the given mesh was smoothed, which rounds its corners, as a fraction of the
    diagonal."""
    mesh_fat_edges: float | None = None
    """How far the given mesh's sharpest edges stand out too much, as a fraction of the
    diagonal."""
    mesh_holes: float | None = None
    """Share of the given mesh's area that is missing, in a dozen holes."""
    contrast: float | None = None
    """Factor on the texture's differences from its mean colour."""
    gain: PerChannel | None = None
    """Factor on the pixel values of all photos but the first, one or by channel."""
    offset: PerChannel | None = None
    """Added to the pixel values (0..255) of all photos but the first, after gain."""
    vignetting: float | None = None
    """Share of the light lost in the corners of every photo."""
    haze: float | None = None
    """Most of each photo that a veil takes, which changes slowly over it, otherwise in
    each."""
    gloss: float | None = None
    """Light of a highlight that moves over the surface with the camera, over that of white
    in full light."""
    sensor_noise: float | None = None
    """Sigma of the noise on every pixel value, of 255."""
    jpeg_quality: int | None = None
    """JPEG quality 1..100 of the photos; 0: PNG, without loss."""
    light: Light | None = None
    """flat: the texture alone; same: shading, fixed to the object; moved: the lamp
    stands elsewhere in each photo."""
    background: Background | None = None
    """Behind the object: nearly black, a plain soft backdrop, textured surroundings."""
    occluder_share: float | None = None
    """Share of the last photo covered by something in front."""
    foliage_share: float | None = None
    """Share of the last photo covered by leaves in front."""
    focal_share: float | None = None
    """Focal length over the photo's width: 0.78 is a phone's."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """The lens of every photo: K1 K2 P1 P2 K3, OpenCV's order. Rough cameras do not
    know it."""
    crop: float = 0.0
    """How far the principal point of each photo is off its middle, as a share of width and
    height, as where another part of it was cut off; to a side drawn for each photo. Rough
    cameras do not know it."""

    def __post_init__(self) -> None:
        if self.kind not in KIND_SETTINGS:
            raise InputError(
                f"There is no scene of kind {self.kind!r}; there are "
                f"{', '.join(KIND_SETTINGS)}."
            )
        if self.seed < 0:
            raise InputError(f"The seed is {self.seed}; give a whole number from 0 up.")
        if self.n_photos < 2:
            raise InputError(f"A scene has at least 2 photos, not {self.n_photos}.")
        settings = self.settings()
        if min(settings.width, settings.height) < 16:
            raise InputError(
                f"Photos of {settings.width}x{settings.height} px are too small; give at "
                "least 16 px on each side."
            )
        if (
            settings.focal_share is not None
            and not 0.1 <= settings.focal_share <= 100.0
        ):
            raise InputError(
                f"The focal length is {settings.focal_share:g} times the photo's width; "
                "give 0.1 to 100."
            )
        Lens(*self.distortion)
        if not 0.0 <= self.crop <= 0.5:
            raise InputError(
                f"crop is {self.crop:g}; give how far principal points are off, as a share "
                "of the photo, 0 to 0.5."
            )
        for name in ("mesh_noise", "mesh_noise_length", "mesh_smoothing", "gloss"):
            if not 0.0 <= getattr(settings, name) < np.inf:
                raise InputError(
                    f"{name} is {getattr(settings, name):g}; give 0 or more."
                )
        for name in ("haze", "mesh_holes", "foliage_share"):
            if not 0.0 <= getattr(settings, name) <= 0.9:
                raise InputError(
                    f"{name} is {getattr(settings, name):g}; give a share, 0 to 0.9."
                )
        if not 0.0 <= settings.occluder_share < 1.0:
            raise InputError(
                f"The occluder's share is {settings.occluder_share:g}; give 0 to 1."
            )
        if not 0 <= settings.jpeg_quality <= 100:
            raise InputError(
                f"The JPEG quality is {settings.jpeg_quality}; give 1 to 100, or 0 for PNG."
            )

    def settings(self) -> SceneSettings:
        """Every setting decided: the caller's, else the kind's, else the default."""
        names = [field.name for field in dataclasses.fields(SceneSettings)]
        given = {name: getattr(self, name) for name in names}
        return SceneSettings(
            **{
                **KIND_SETTINGS[self.kind],
                **{name: value for name, value in given.items() if value is not None},
            }
        )
