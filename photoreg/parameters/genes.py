"""Cameras as vectors of genes, and the box around the pre-registration they live in.

A gene is a number in [-1, 1]: 0 is the pre-registration, +-1 the ends of the gene's
interval. A search therefore needs to know neither cameras nor units.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.rotations import rotation_matrices, rotation_vectors
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.gene_box import CameraModel, Coordinates, GeneBox
from photoreg.words import listed


@dataclasses.dataclass(frozen=True, eq=False)
class Poses:
    """K, R and t of every camera of every individual of a population."""

    K: Float[np.ndarray, "p c 3 3"]
    R_cam_world: Float[np.ndarray, "p c 3 3"]
    t_cam_world: Float[np.ndarray, "p c 3"]

    @property
    def P(self) -> Float[np.ndarray, "p c 3 4"]:
        """Projection matrices K [R | t]."""
        return self.K @ np.concatenate(
            [self.R_cam_world, self.t_cam_world[..., None]], axis=-1
        )

    @property
    def centers(self) -> Float[np.ndarray, "p c 3"]:
        """Camera centres in world axes."""
        return -np.einsum("pcji,pcj->pci", self.R_cam_world, self.t_cam_world)


class GeneMap:
    """Cameras to genes and back, around given start cameras.

    Coordinates of the genes of one camera, in this order:

    - ``camera``, the paper's: f (or fx, fy, skew), principal point x y, rotation
      about the camera's centre (3, camera axes), camera centre (3, world axes).
    - ``object``: log f at constant size in the photo (or that, aspect, skew),
      principal point x y with the camera re-aimed, rotation about the object's
      centroid (3, camera axes), log size in the photo, place in the photo x y.
      Turning about the own centre and moving sideways look the same in a photo, so
      do focal length and distance; these genes are what a photo tells apart.

    What a ``Freedom`` holds has no gene, and a shared focal length has one, after the
    genes of the camera that leads its group. In ``object`` coordinates focal length
    and distance are then apart: where the focal length is held or shared, the size in
    the photo is the distance's; where the pose is held, the focal length's.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        pivot: Float[np.ndarray, "3"],
        box: GeneBox | None = None,
        model: CameraModel = "pinhole",
        coordinates: Coordinates = "camera",
        freedom: Freedom | None = None,
    ) -> None:
        """``pivot`` is the object's centroid in world axes.

        Photos that share a focal length should have it already; see
        ``Freedom.begin``.

        Raises:
            InputError: if there is no camera or the centroid is not in front of one.
        """
        if len(cameras) == 0:
            raise InputError("There is no camera to vary.")
        self.start = tuple(cameras)
        self.pivot = np.asarray(pivot, dtype=np.float64)
        self.box = GeneBox() if box is None else box
        self.model: CameraModel = model
        self.coordinates: Coordinates = coordinates
        self.freedom = Freedom() if freedom is None else freedom
        self._K = np.array([camera.K for camera in cameras])
        self._R = np.array([camera.R_cam_world for camera in cameras])
        self._t = np.array([camera.t_cam_world for camera in cameras])
        self._sizes = np.array([[c.width, c.height] for c in cameras], dtype=float)
        self._pivot_cam = self._R @ self.pivot + self._t
        if coordinates == "object" and not (self._pivot_cam[:, 2] > 0.0).all():
            behind = int(np.flatnonzero(~(self._pivot_cam[:, 2] > 0.0))[0])
            raise InputError(
                f"Camera {behind + 1} looks away: the object's centroid is not in "
                "front of it. Align it first."
            )
        self.distances = np.linalg.norm(self._pivot_cam, axis=1)
        self._widths = self._half_widths()
        self._spread, self._names = self._what_genes_move()
        self._gathered = np.linalg.pinv(self._spread)

    @property
    def n_per_camera(self) -> int:
        """Parameters of one camera: 9, or 11 in the full model."""
        return 9 if self.model == "pinhole" else 11

    @property
    def n_genes(self) -> int:
        """Genes of all cameras: one a parameter that is free."""
        return self._spread.shape[1]

    def _half_widths(self) -> np.ndarray:
        """(c, g) interval half-widths in the units of each parameter."""
        rows = []
        for c, (size, distance, K) in enumerate(
            zip(self._sizes, self.distances, self._K, strict=True)
        ):
            box = self.box.cropped() if self.freedom.is_cropped(c) else self.box
            lens = [box.focal]
            if self.model == "full":
                skew = box.skew * K[0, 0]
                second = box.focal if self.coordinates == "camera" else box.aspect
                lens += [second, skew]
            turn = [np.radians(box.rotation_deg)] * 3
            if self.coordinates == "camera":
                place = [box.translation * distance] * 3
            else:
                place = [box.scale, *[box.shift * size.max()] * 2]
            rows.append([*lens, *(box.principal_point * size), *turn, *place])
        return np.array(rows)

    def poses(self, genes: Float[np.ndarray, "p g"]) -> Poses:
        """The cameras of a whole population at once."""
        return self._exact(self._poses(self._values(genes)))

    def _values(self, genes: np.ndarray) -> np.ndarray:
        """(p, c, parameters) in the units of each parameter, zero at the start."""
        spread = np.asarray(genes, dtype=np.float64) @ self._spread.T
        return spread.reshape(-1, *self._widths.shape) * self._widths

    def _exact(self, poses: Poses) -> Poses:
        """What is held to the last bit, and one focal length where it is shared."""
        K, R, t = poses.K, poses.R_cam_world, poses.t_cam_world
        for c in range(len(self.start)):
            held = self.freedom.of(c)
            if held.focal:
                K[:, c, :2, :2] = self._K[c, :2, :2]
            elif not self.freedom.leads(c):
                K[:, c, :2, :2] = K[:, self.freedom.group(c)[0], :2, :2]
            if held.pose:
                R[:, c], t[:, c] = self._R[c], self._t[c]
        return poses

    def _poses(self, values: np.ndarray) -> Poses:
        n_lens = self.n_per_camera - 8
        lens, principal = values[..., :n_lens], values[..., n_lens : n_lens + 2]
        turn, place = values[..., n_lens + 2 : n_lens + 5], values[..., n_lens + 5 :]
        K = np.broadcast_to(self._K, (*values.shape[:2], 3, 3)).copy()
        K[..., :2, 2] += principal
        if self.coordinates == "camera":
            K[..., 0, 0] *= 1.0 + lens[..., 0]
            K[..., 1, 1] *= 1.0 + lens[..., 1 if self.model == "full" else 0]
            if self.model == "full":
                K[..., 0, 1] += lens[..., 2]
            R = rotation_matrices(turn) @ self._R
            center = -np.einsum("cji,cj->ci", self._R, self._t) + place
            return Poses(K, R, -np.einsum("pcij,pcj->pci", R, center))
        zoom = np.exp(lens[..., 0] + place[..., 0])
        K[..., 0, 0] *= zoom
        K[..., 1, 1] *= zoom
        if self.model == "full":
            K[..., 1, 1] *= np.exp(lens[..., 1])
            K[..., 0, 1] += lens[..., 2]
        R = rotation_matrices(turn) @ rotation_matrices(self._aim(principal)) @ self._R
        pixel = self._pivot_pixel + place[..., 1:]
        depth = self._pivot_cam[:, 2] * np.exp(lens[..., 0])
        pivot_cam = np.ones((*values.shape[:2], 3))
        pivot_cam[..., 1] = (pixel[..., 1] - K[..., 1, 2]) / K[..., 1, 1]
        pivot_cam[..., 0] = (
            pixel[..., 0] - K[..., 0, 2] - K[..., 0, 1] * pivot_cam[..., 1]
        ) / K[..., 0, 0]
        pivot_cam *= depth[..., None]
        return Poses(K, R, pivot_cam - R @ self.pivot)

    def to_cameras(self, genes: Float[np.ndarray, "g"]) -> list[Camera]:
        """The cameras of one individual."""
        poses = self.poses(np.asarray(genes)[None])
        return [
            Camera(
                poses.K[0, c],
                poses.R_cam_world[0, c],
                poses.t_cam_world[0, c],
                start.width,
                start.height,
                start.lens,
            )
            for c, start in enumerate(self.start)
        ]

    def to_genes(self, cameras: Sequence[Camera]) -> Float[np.ndarray, "g"]:
        """The genes of cameras; outside [-1, 1] where they are outside the box.

        What the genes cannot express (another aspect ratio or skew than the start's in
        the pinhole model, what is held) is left out.
        """
        K = np.array([camera.K for camera in cameras])
        R = np.array([camera.R_cam_world for camera in cameras])
        t = np.array([camera.t_cam_world for camera in cameras])
        principal = K[:, :2, 2] - self._K[:, :2, 2]
        ratio = K[:, [0, 1], [0, 1]] / self._K[:, [0, 1], [0, 1]]
        skew = (K[:, 0, 1] - self._K[:, 0, 1])[:, None]
        if self.coordinates == "camera":
            turn = rotation_vectors(R @ np.swapaxes(self._R, -1, -2))
            center = -np.einsum("cji,cj->ci", R, t)
            place = center + np.einsum("cji,cj->ci", self._R, self._t)
            lens = [ratio[:, :1] - 1.0]
            if self.model == "full":
                lens += [ratio[:, 1:] - 1.0, skew]
        else:
            aimed = rotation_matrices(self._aim(principal)) @ self._R
            turn = rotation_vectors(R @ np.swapaxes(aimed, -1, -2))
            pivot_cam = R @ self.pivot + t
            pixel = _pixels(K, pivot_cam)
            depth = np.log(pivot_cam[:, 2:] / self._pivot_cam[:, 2:])
            size = np.log(ratio[:, :1]) - depth
            place = np.concatenate([size, pixel - self._pivot_pixel], axis=1)
            lens = [depth]
            if self.model == "full":
                lens += [np.log(ratio[:, 1:] / ratio[:, :1]), skew]
        values = np.concatenate([*lens, principal, turn, place], axis=1)
        return self._gathered @ (values / self._widths).ravel()

    @property
    def _pivot_pixel(self) -> np.ndarray:
        return _pixels(self._K, self._pivot_cam)

    def _aim(self, principal: np.ndarray) -> np.ndarray:
        """Rotation vectors that re-aim a camera whose principal point moved."""
        zero = np.zeros(principal.shape[:-1])
        return np.stack(
            [
                principal[..., 1] / self._K[:, 1, 1],
                -principal[..., 0] / self._K[:, 0, 0],
                zero,
            ],
            axis=-1,
        )

    def names(self) -> list[str]:
        """What each gene is, in plain words, with the camera's number."""
        return list(self._names)

    def _what_genes_move(self) -> tuple[np.ndarray, list[str]]:
        """Parameters of all cameras by genes (c parameters, g), and the genes' names.

        Both in half-intervals: without anything held it is the identity.
        """
        per, widths = self.n_per_camera, self._widths
        n_lens = per - 8
        size = per - 3  # Where ``object`` coordinates have the size in the photo.
        columns: list[dict[int, float]] = []
        names: list[str] = []
        words = self._parameter_names()
        of_group: dict[tuple[int, ...], list[int]] = {}
        for c in range(len(self.start)):
            held, group = self.freedom.of(c), self.freedom.group(c)
            is_object = self.coordinates == "object"
            alone = len(group) == 1
            split = is_object and (held.focal or not alone)
            for k in range(per):
                name = f"camera {c + 1}: {words[k]}"
                moves = {c * per + k: 1.0}
                if k < n_lens:
                    if held.focal:
                        continue
                    if k == 0 and is_object and (held.pose or not alone):
                        # All of the focal length that the whole box reaches.
                        reach = float(widths[c, 0] + widths[c, size])
                        at = size if held.pose else 0
                        moves = {c * per + at: reach / widths[c, at]}
                    if not alone:
                        numbers = listed([str(photo + 1) for photo in group])
                        name = f"focal length of cameras {numbers}"
                        if words[k] != "focal length":
                            name = f"{words[k]} of cameras {numbers}"
                        of_group.setdefault(group, [])
                        if not self.freedom.leads(c):
                            columns[of_group[group][k]].update(moves)
                            continue
                        of_group[group].append(len(columns))
                elif k < n_lens + 2:
                    if held.principal_point:
                        continue
                elif held.pose:
                    continue
                elif k == size and split:
                    moves[c * per] = -float(widths[c, size] / widths[c, 0])
                    name = f"camera {c + 1}: distance"
                columns.append(moves)
                names.append(name)
        spread = np.zeros((len(self.start) * per, len(columns)))
        for column, moves in enumerate(columns):
            for row, share in moves.items():
                spread[row, column] = share
        return spread, names

    def _parameter_names(self) -> list[str]:
        if self.coordinates == "camera":
            place = ["centre x", "centre y", "centre z"]
            lens = ["focal length"] if self.model == "pinhole" else ["fx", "fy", "skew"]
        else:
            place = [
                "size in the photo",
                "place in the photo x",
                "place in the photo y",
            ]
            lens = ["focal length"]
            if self.model == "full":
                lens += ["aspect ratio", "skew"]
        middle = ["principal point x", "principal point y"]
        turn = ["rotation x", "rotation y", "rotation z"]
        return [*lens, *middle, *turn, *place]

    def first_population(
        self, n: int, rng: np.random.Generator, tie_focal_to_distance: bool = True
    ) -> Float[np.ndarray, "n g"]:
        """Individuals drawn evenly from the box.

        With ``tie_focal_to_distance``, the paper's equation 4, f / d ~ w / W: where a
        draw's focal length is k times the start's, its camera is moved along the line
        from the centroid so that its distance is k times the start's; sideways the
        draw stays. In ``object`` coordinates this is built into the genes.
        """
        genes = rng.uniform(-1.0, 1.0, (n, self.n_genes))
        if not tie_focal_to_distance or self.coordinates == "object":
            return genes
        values = self._values(genes)
        n_focal = 2 if self.model == "full" else 1
        k = 1.0 + values[..., :n_focal].mean(axis=-1)
        center = -np.einsum("cji,cj->ci", self._R, self._t)
        away = (center - self.pivot) / self.distances[:, None]
        place = values[..., -3:]
        along = np.einsum("pcd,cd->pc", place, away)
        wanted = (k - 1.0) * self.distances
        may_move = [not self.freedom.of(c).pose for c in range(len(self.start))]
        values[..., -3:] += np.where(may_move, wanted - along, 0.0)[..., None] * away
        tied = (values / self._widths).reshape(n, -1) @ self._gathered.T
        return np.clip(tied, -1.0, 1.0)


def _pixels(K: np.ndarray, points_cam: np.ndarray) -> np.ndarray:
    homogeneous = np.einsum("cij,cj->ci", K, points_cam)
    return homogeneous[:, :2] / homogeneous[:, 2:]
