"""Numbers that move a camera, chosen so that they do not fight each other.

Turning a camera about its own centre and shifting it look alike in the photo. Here
the object turns about a pivot (the middle of what the photo sees of it) in camera
axes, the pivot shifts in camera axes, and the focal length changes by a factor. All
are in units of the prior: 1 is one interval of the pre-registration, so the numbers
have no units and the prior's normal matrix is the identity.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import N_TERMS, TERMS, Distortion, Lens
from photoreg.geometry.projection import CAMERA, fill_record
from photoreg.geometry.rotations import left_jacobian, rotation_matrix, rotation_vector
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.camera_parameters import (
    FOCAL,
    LENS_TERMS,
    N_PINHOLE,
    POSITION,
    PRINCIPAL,
    ROTATION,
    Parameter,
    camera_parameters,
)
from photoreg.parameters.freedom import NOTHING_HELD, Freedom, Held


@dataclasses.dataclass(frozen=True, eq=False)
class Increments:
    """The map from some numbers to a camera, around one base camera.

    The numbers are those of ``parameters``: nine, and the terms of the lens that are
    solved.
    """

    base: Camera
    """The camera at zero: the pre-registration."""
    pivot: Float[np.ndarray, "3"]
    """World point that the rotation leaves where it is."""
    scales: PriorScales
    held: Held = NOTHING_HELD
    """What stays as the base has it, to the last bit: its numbers move nothing, and so
    are always 0."""
    distortion: Distortion = "none"
    """How much of the lens is solved."""
    is_cropped: bool = False
    """Whether a part of the photo was cut off, so that the principal point may be far off
    its middle."""

    @functools.cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What the numbers are, in order."""
        return camera_parameters(self.distortion)

    @property
    def n(self) -> int:
        """How many numbers there are."""
        return len(self.parameters)

    def own(self, photo: int) -> slice:
        """Where the numbers of a photo's camera are among those of all."""
        return slice(photo * self.n, (photo + 1) * self.n)

    @property
    def distance(self) -> float:
        """Distance from the base camera's centre to the pivot, in model units."""
        return float(np.linalg.norm(self.base.center - self.pivot))

    @property
    def _scales(self) -> PriorScales:
        return self.scales.cropped() if self.is_cropped else self.scales

    @property
    def units(self) -> Float[np.ndarray, "n"]:
        """Size of one unit of each number: radians, model units, a logarithm, pixels.

        0 where nothing may move.
        """
        base, distance, scales = self.base, self.distance, self._scales
        units = [one.sigma(scales, base, distance) for one in self.parameters]
        return np.where(self.is_free, units, 0.0)

    @property
    def limits(self) -> Float[np.ndarray, "n"]:
        """Largest size of each number: within, every vector is a camera."""
        units, distance = self.units, self.distance
        most = [one.limit(self.base, distance) for one in self.parameters]
        return np.divide(most, units, out=np.full(self.n, np.inf), where=units > 0.0)

    @property
    def is_free(self) -> Bool[np.ndarray, "n"]:
        """Which numbers may move something."""
        return np.array([not self.held.holds(one.part) for one in self.parameters])

    @property
    def plain_units(self) -> Float[np.ndarray, "n"]:
        """One unit of each number in the units shown to users: degrees, percent, pixels."""
        units = zip(self.parameters, self.units, strict=True)
        return np.array(
            [
                unit if one.plain is None else one.plain(self._scales, self.base)
                for one, unit in units
            ]
        )

    @property
    def precision(self) -> Float[np.ndarray, "n n"]:
        """Inverse covariance of the prior.

        One unit each, apart; but who aligned a cropped photo has it aimed at the object
        whatever the principal point is. There the prior is on turn and shift beyond
        those which keep the object in its place as the principal point moves.
        """
        apart = np.eye(self.n)
        units, K = self.units, self.base.K
        if self.is_cropped and units[PRINCIPAL].any() and units[ROTATION].all():
            (x, y), (turn_x, turn_y, _) = range(self.n)[PRINCIPAL], units[ROTATION]
            shift_x, shift_y, _ = units[POSITION]
            depth = self.base.to_camera(self.pivot[None])[0, 2]
            by_x, by_y = units[x] / K[0, 0], units[y] / K[1, 1]
            apart[ROTATION.start + 1, x] = by_x / turn_y
            apart[ROTATION.start, y] = -by_y / turn_x
            apart[POSITION.start, x] = by_x * depth / shift_x
            apart[POSITION.start + 1, y] = by_y * depth / shift_y
        return apart.T @ apart

    def camera(self, x: Float[np.ndarray, "n"]) -> Camera:
        """The camera at ``x``."""
        step = np.asarray(x) * self.units
        base = self.base
        R = rotation_matrix(step[ROTATION]) @ base.R_cam_world
        pivot_cam = base.R_cam_world @ self.pivot + base.t_cam_world + step[POSITION]
        K = base.K.copy()
        K[:2, :2] *= np.exp(step[FOCAL])
        K[:2, 2] += step[PRINCIPAL]
        lens = self._lens(step)
        if self.held.pose:
            return dataclasses.replace(base, K=K, lens=lens)
        return Camera(K, R, pivot_cam - R @ self.pivot, base.width, base.height, lens)

    def _lens(self, step: np.ndarray) -> Lens:
        solved = step[LENS_TERMS]
        if not solved.any():
            return self.base.lens
        terms = np.array(self.base.lens.terms)
        terms[: len(solved)] += solved
        return Lens(*terms)

    def of_camera(self, camera: Camera) -> Float[np.ndarray, "n"]:
        """The numbers of a camera of the same photo.

        Ratio of focal lengths, skew and what is not solved of the lens stay the base's;
        other cameras are met as well as the numbers can.
        """
        base = self.base
        turn = rotation_vector(camera.R_cam_world @ base.R_cam_world.T)
        shift = (
            camera.R_cam_world @ self.pivot
            + camera.t_cam_world
            - base.R_cam_world @ self.pivot
            - base.t_cam_world
        )
        log_focal = np.log(camera.focal_px / base.focal_px)
        n_terms = N_TERMS[self.distortion]
        lens = np.subtract(camera.lens.terms, base.lens.terms)[:n_terms]
        step = np.concatenate(
            [turn, shift, [log_focal], camera.K[:2, 2] - base.K[:2, 2], lens]
        )
        free = self.is_free
        return np.where(free, step, 0.0) / np.where(free, self.units, 1.0)

    def record(self, x: Float[np.ndarray, "n"], width: int, height: int) -> np.void:
        """The camera at ``x``, for a photo resampled to width x height, for kernels.

        A record of ``CAMERA``. It has no fold: points are chosen where the lens
        shows them, and a step of the polish must not gain by losing them.
        """
        camera, units = self.camera(x).resized(width, height), self.units
        record = np.zeros(1, CAMERA)[0]
        pivot_cam = camera.R_cam_world @ self.pivot + camera.t_cam_world
        fill_record(
            record, camera.K, camera.R_cam_world, self.pivot, pivot_cam, camera.lens
        )
        record["max_radius2"] = np.inf
        turn = np.asarray(x)[ROTATION] * units[ROTATION]
        record["turn"] = left_jacobian(turn) * units[ROTATION][0]
        record["shift"], record["zoom"] = units[POSITION][0], units[FOCAL]
        record["middle"] = units[PRINCIPAL] * (
            width / self.base.width,
            height / self.base.height,
        )
        record["bend"][: N_TERMS[self.distortion]] = units[LENS_TERMS]
        return record


def numbers_of(
    photos: Sequence[int], increments: Sequence[Increments]
) -> Int[np.ndarray, "k"]:
    """Where the numbers of some photos' cameras are among those of all.

    Args:
        photos: By index.
        increments: Of these photos.
    """
    own = [one.own(photo) for photo, one in zip(photos, increments, strict=True)]
    return np.concatenate([np.arange(rows.start, rows.stop) for rows in own])


def free_directions(
    increments: Sequence[Increments], freedom: Freedom, n_lens_terms: int = len(TERMS)
) -> Float[np.ndarray, "p q"]:
    """One column a number that moves by itself: 1 at each of its rows, else 0.

    The rows are the numbers of each camera. What is held has no column; a shared focal
    length has one, with a 1 for each camera that shares it, and so has a shared lens.
    Of a lens's terms only the first ``n_lens_terms`` move.
    """
    free = np.concatenate([one.is_free for one in increments])
    n = increments[0].n
    columns = []
    for row in np.flatnonzero(free):
        camera, which = divmod(int(row), n)
        if which >= N_PINHOLE + n_lens_terms:
            continue
        column = np.zeros(len(free))
        if not increments[camera].parameters[which].is_shared:
            column[row] = 1.0
        elif freedom.leads(camera):
            group = np.array(freedom.group(camera))
            column[group * n + which] = 1.0
        else:
            continue
        columns.append(column)
    return np.column_stack(columns)
