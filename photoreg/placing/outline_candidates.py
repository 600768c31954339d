"""The poses in which a mesh has the outline that a photo shows of the object."""

import dataclasses
from collections.abc import Sequence

from photoreg.geometry.camera import Camera, centred_camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.placing.rim_fit import FIRST_CUT, fit_outline, outline_of
from photoreg.placing.segmentation import Segmentation
from photoreg.placing.silhouette_grid import SilhouetteGrid, angle_deg

N_FIRST, SIDE_FIRST_PX, STEPS_FIRST = 80, 112, 8
"""Poses of the grid that are fitted, at which size of the photo, in how many steps."""
N_SECOND, SIDE_SECOND_PX, STEPS_SECOND = 16, 224, 10
"""The same of the best of these that differ."""
N_KEPT = 24
"""Distinct poses that other photos may choose from."""
SAME_DEG = 6.0
"""Poses nearer than this are the same one, found twice."""
FINE_FACES = 20_000
GUESSED_FOCAL = 1.2
"""Focal length over the photo's longer side where it is unknown: a phone's is 0.75, a
portrait lens's 2.4."""
FOCAL_LADDER = (0.7, 1.0, 1.4, 2.0, 2.8)
"""Focal lengths over the photo's longer side that are then tried: two for each doubling,
from a wide-angle lens to a short telephoto lens."""
N_LADDER, STEPS_LADDER = 6, 6
"""Poses that they are tried with. The outline tells the focal length by perspective only,
so a pose that is wrong does not come right by it."""
N_FREE, SIDE_FREE_PX, STEPS_FREE, CUT_FREE = 3, 320, 12, 0.02
"""Poses whose focal length is then let go."""


@dataclasses.dataclass(frozen=True, eq=False)
class Candidate:
    """A pose and how well its outline fits."""

    camera: Camera
    """Of the photo's full size."""
    overlap: float


class OutlineSearch:
    """Finds poses by outlines, for any number of photos of one mesh."""

    def __init__(self, mesh: Mesh) -> None:
        self.grid = SilhouetteGrid(mesh)
        self.fine = mesh.decimated(FINE_FACES)

    def candidates(
        self, photo: Photo, found: Segmentation, focal_px: float | None
    ) -> list[Candidate]:
        """Poses that differ, the best first, ``N_KEPT`` at most.

        Args:
            photo: The photo.
            found: The object in it.
            focal_px: The photo's focal length; None where it is unknown.
        """
        side = max(photo.width, photo.height)
        base = centred_camera(
            focal_px or GUESSED_FOCAL * side, photo.width, photo.height
        )
        height, width = found.covered.shape
        small = outline_of(found.covered, SIDE_FIRST_PX)
        large = outline_of(found.covered, SIDE_SECOND_PX)
        if small is None or large is None:
            return []
        first = [
            Candidate(*fit_outline(self.grid.mesh, small, camera, STEPS_FIRST))
            for pose in self.grid.poses(
                found.covered, base.resized(width, height), N_FIRST
            )
            for camera in [
                dataclasses.replace(
                    base, R_cam_world=pose.R_cam_world, t_cam_world=pose.t_cam_world
                )
            ]
        ]
        kept = distinct(first, SAME_DEG)[:N_KEPT]
        n = N_SECOND if focal_px is not None else N_LADDER
        focals = (
            [None] if focal_px is not None else [share * side for share in FOCAL_LADDER]
        )
        steps = STEPS_SECOND if focal_px is not None else STEPS_LADDER
        second = []
        for one in kept[:n]:
            ends = [
                Candidate(
                    *fit_outline(
                        self.fine,
                        large,
                        self._with_focal(one.camera, focal),
                        steps,
                        first_cut=0.5 * FIRST_CUT,
                    )
                )
                for focal in focals
            ]
            second.append(_best(ends))
        # What was fitted coarsely is worth less by as much as the best one lost.
        rest = [
            Candidate(one.camera, min(one.overlap, _best(second).overlap))
            for one in kept[n:]
        ]
        if focal_px is None:
            second = self._with_free_focals(distinct(second, SAME_DEG), found)
        return distinct([*second, *rest], SAME_DEG)

    def _with_free_focals(
        self, candidates: Sequence[Candidate], found: Segmentation
    ) -> list[Candidate]:
        outline = outline_of(found.covered, SIDE_FREE_PX)
        if outline is None:
            return list(candidates)
        freed = [
            Candidate(
                *fit_outline(
                    self.fine,
                    outline,
                    one.camera,
                    STEPS_FREE,
                    first_cut=CUT_FREE,
                    frees_focal=True,
                )
            )
            for one in candidates[:N_FREE]
        ]
        return [*freed, *candidates[N_FREE:]]

    def _with_focal(self, camera: Camera, focal_px: float | None) -> Camera:
        """The camera with another focal length, from where the object is as large."""
        if focal_px is None:
            return camera
        factor = focal_px / camera.focal_px
        K = camera.K.copy()
        K[:2, :2] *= factor
        turned = camera.R_cam_world @ self.grid.middle
        middle = (turned + camera.t_cam_world) * [1.0, 1.0, factor]
        return dataclasses.replace(camera, K=K, t_cam_world=middle - turned)


def _best(candidates: Sequence[Candidate]) -> Candidate:
    return max(candidates, key=lambda one: one.overlap)


def distinct(candidates: Sequence[Candidate], by_deg: float) -> list[Candidate]:
    """The best of each group of poses that do not differ by so much, the best first."""
    kept: list[Candidate] = []
    for one in sorted(candidates, key=lambda one: -one.overlap):
        if all(differ(one.camera, other.camera, by_deg) for other in kept):
            kept.append(one)
    return kept


def differ(a: Camera, b: Camera, by_deg: float) -> bool:
    """Whether two cameras see an object from sides that differ by so many degrees."""
    return angle_deg(a.R_cam_world, b.R_cam_world) > by_deg
