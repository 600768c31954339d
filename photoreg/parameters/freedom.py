"""What a refinement may move: which parts of which camera, and which go together."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens

SAME_FOCAL = 1e-9
"""Focal lengths closer than this, relatively, are one."""


@dataclasses.dataclass(frozen=True)
class Held:
    """What of one camera stays exactly as it was given."""

    focal: bool = False
    """The focal length, with the aspect ratio and the skew."""
    principal_point: bool = False
    """The principal point."""
    pose: bool = False
    """Where the camera stands and how it is turned."""
    lens: bool = dataclasses.field(default=False, repr=False)
    """The distortion of the lens. It stays too where everything else does."""

    @property
    def everything(self) -> bool:
        """Whether the whole camera stays."""
        return self.focal and self.principal_point and self.pose

    def holds(self, part: Literal["pose", "focal", "principal_point", "lens"]) -> bool:
        """Whether a part of the camera stays."""
        return getattr(self, part) or self.everything


NOTHING_HELD = Held()


@dataclasses.dataclass(frozen=True)
class Freedom:
    """What a refinement may move; by default all of every camera, each by itself.

    Photos go by their place in the list, from 0. A camera that is held still votes: a
    photo can be registered against another one that is already right.
    """

    held: tuple[Held, ...] = ()
    """What stays, one a photo; empty: nothing anywhere."""
    shared_focal: tuple[tuple[int, ...], ...] = ()
    """Groups of photos taken with one camera at one zoom: each group has one focal
    length (aspect ratio and skew with it) and one lens. Where one photo of a group is held, the
    others take its focal length. Otherwise unequal starts begin at their geometric
    mean, each camera moved along its view so that the object keeps its size."""
    cropped: tuple[int, ...] = dataclasses.field(default=(), repr=False)
    """Photos of which a part was cut off: their principal points may be far off the
    middle, and of those that share a focal length with them, for these have their size."""

    def __post_init__(self) -> None:
        groups = tuple(tuple(sorted(group)) for group in self.shared_focal)
        object.__setattr__(self, "shared_focal", groups)
        members = [i for group in groups for i in group]
        twice = sorted({i for i in members if members.count(i) > 1})
        if twice:
            raise InputError(
                f"Photo {twice[0] + 1} shares its focal length twice; name each photo "
                "in one group, once."
            )
        if members and min(members) < 0:
            raise InputError(f"There is no photo number {min(members) + 1}.")

    @classmethod
    def of_photos(
        cls,
        names: Sequence[str],
        *,
        lock: Sequence[str] = (),
        lock_focal: Sequence[str] = (),
        lock_principal_point: Sequence[str] = (),
        lock_pose: Sequence[str] = (),
        lock_distortion: Sequence[str] = (),
        share_focal: Sequence[Sequence[str]] = (),
        cropped: Sequence[str] = (),
    ) -> "Freedom":
        """The freedom of photos that go by name.

        Args:
            names: Of all photos, in order.
            lock: Photos whose cameras stay whole.
            lock_focal: Photos whose focal lengths stay.
            lock_principal_point: Photos whose principal points stay.
            lock_pose: Photos whose cameras stay where they stand.
            lock_distortion: Photos whose lenses stay as they are.
            share_focal: Groups that share a focal length; an empty group: all photos.
            cropped: Photos of which a part was cut off.

        Raises:
            InputError: if a name is not among ``names``.
        """
        groups = [tuple(group) or tuple(names) for group in share_focal]
        asked = [
            *lock,
            *lock_focal,
            *lock_principal_point,
            *lock_pose,
            *lock_distortion,
            *cropped,
        ]
        for name in [*asked, *(name for group in groups for name in group)]:
            if name not in names:
                raise InputError(
                    f"There is no photo {name} to hold, to share or cropped; there are "
                    f"{', '.join(names)}."
                )
        held = tuple(
            Held(
                name in lock or name in lock_focal,
                name in lock or name in lock_principal_point,
                name in lock or name in lock_pose,
                name in lock or name in lock_distortion,
            )
            for name in names
        )
        return cls(
            held,
            tuple(tuple(list(names).index(name) for name in g) for g in groups),
            tuple(i for i, name in enumerate(names) if name in cropped),
        )

    def of(self, photo: int) -> Held:
        """What of a photo's camera stays, by itself or with those it shares with."""
        own = self._own(photo)
        others = [self._own(k) for k in self.group(photo)]
        return dataclasses.replace(
            own,
            focal=any(other.focal for other in others),
            lens=any(other.holds("lens") for other in others),
        )

    def group(self, photo: int) -> tuple[int, ...]:
        """All photos whose focal length is this one's, itself among them."""
        for group in self.shared_focal:
            if photo in group:
                return group
        return (photo,)

    def is_cropped(self, photo: int) -> bool:
        """Whether a photo's principal point may be far off its middle."""
        return any(other in self.cropped for other in self.group(photo))

    def leads(self, photo: int) -> bool:
        """Whether a photo is the first of those that share its focal length."""
        return self.group(photo)[0] == photo

    def require(self, cameras: Sequence[Camera], names: Sequence[str]) -> None:
        """Checks that these cameras can be refined so.

        Raises:
            InputError: if the numbers differ, nothing may move, or photos share a
                focal length that cannot be the same.
        """
        n = len(cameras)
        if self.held and len(self.held) != n:
            raise InputError(
                f"What to hold was given for {len(self.held)} photos, but there are {n}."
            )
        for group in self.shared_focal:
            if max(group, default=0) >= n:
                raise InputError(
                    f"Photo {max(group) + 1} should share its focal length, but there "
                    f"are {n} photos."
                )
            self._require_one_lens(group, cameras, names)
        if not all(0 <= i < n for i in self.cropped):
            raise InputError(
                f"Photo {max(self.cropped) + 1} should be a cropped one, but there are {n} "
                "photos."
            )
        if all(self.of(i).everything for i in range(n)):
            raise InputError(
                "Every camera is held whole, so nothing can be refined; let one move."
            )

    def _require_one_lens(
        self, group: tuple[int, ...], cameras: Sequence[Camera], names: Sequence[str]
    ) -> None:
        for i in group[1:]:
            first, other = cameras[group[0]], cameras[i]
            sizes = (first.width, first.height), (other.width, other.height)
            if sorted(sizes[0]) != sorted(sizes[1]):
                raise InputError(
                    f"{names[group[0]]} and {names[i]} cannot share a focal length: "
                    f"they have {sizes[0][0]}x{sizes[0][1]} and "
                    f"{sizes[1][0]}x{sizes[1][1]} px, and photos of one camera and zoom "
                    "have one size."
                )
        fixed = [i for i in group if self._own(i).focal]
        for i in fixed[1:]:
            first, other = cameras[fixed[0]].focal_px, cameras[i].focal_px
            if abs(first / other - 1.0) > SAME_FOCAL:
                raise InputError(
                    f"{names[fixed[0]]} and {names[i]} should share a focal length, but "
                    f"theirs are held at {first:.6g} and {other:.6g} px; hold one of "
                    "them only."
                )

    def begin(
        self, cameras: Sequence[Camera], pivot: Float[np.ndarray, "3"]
    ) -> tuple[Camera, ...]:
        """The cameras to start from: equal focal lengths where they are shared.

        A camera whose focal length changes moves along the line from ``pivot``, the
        object's centroid, so that the object keeps its size in the photo; not if its
        pose is held.
        """
        begun = list(cameras)
        for group in self.shared_focal:
            lens = self._shared_lens(group, cameras)
            for i in group:
                begun[i] = begun[i].with_lens(lens)
            scales = np.array([cameras[i].K[:2, :2] for i in group])
            fixed = [i for i in group if self._own(i).focal]
            if fixed:
                scale = cameras[fixed[0]].K[:2, :2]
            elif np.ptp(scales, axis=0).max(initial=0.0) == 0.0:
                continue
            else:
                scale = scales.mean(axis=0)
                scale[[0, 1], [0, 1]] = np.exp(
                    np.log(scales[:, [0, 1], [0, 1]]).mean(axis=0)
                )
            for i in group:
                begun[i] = _with_focal(
                    begun[i], scale, None if self._own(i).pose else pivot
                )
        return tuple(begun)

    def _shared_lens(self, group: tuple[int, ...], cameras: Sequence[Camera]) -> Lens:
        """The lens of photos that share it: a held one, or else their mean."""
        fixed = [i for i in group if self._own(i).holds("lens")]
        lenses = [cameras[i].lens for i in fixed[:1] or group]
        if all(lens == lenses[0] for lens in lenses):
            return lenses[0]
        return Lens(*np.mean([lens.terms for lens in lenses], axis=0).tolist())

    def subset(self, photos: Sequence[int]) -> "Freedom":
        """The freedom of some of the photos, renumbered in their order."""
        place = {photo: k for k, photo in enumerate(photos)}
        groups = [
            tuple(place[i] for i in group if i in place) for group in self.shared_focal
        ]
        return Freedom(
            tuple(self.of(i) for i in photos),
            tuple(g for g in groups if len(g) > 1),
            tuple(k for k, i in enumerate(photos) if self.is_cropped(i)),
        )

    def _own(self, photo: int) -> Held:
        return self.held[photo] if self.held else NOTHING_HELD


def _with_focal(camera: Camera, scale: np.ndarray, pivot: np.ndarray | None) -> Camera:
    """The camera with another focal length, as the upper left block of its K.

    Moved so that ``pivot`` keeps its size and place.
    """
    K = camera.K.copy()
    K[:2, :2] = scale
    t = camera.t_cam_world
    if pivot is not None:
        turned = camera.R_cam_world @ pivot
        at = turned + t
        zoom = np.sqrt(np.linalg.det(scale) / np.linalg.det(camera.K[:2, :2]))
        depth = zoom * at[2]
        place = np.linalg.solve(scale, camera.K[:2, :2] @ at[:2] / at[2])
        t = np.append(place * depth, depth) - turned
    return dataclasses.replace(camera, K=K, t_cam_world=t)
