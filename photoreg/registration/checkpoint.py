"""The state of a refinement, saved so that it can be resumed to the same answer."""

import base64
import dataclasses
import hashlib
import json
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.parameters.freedom import Freedom
from photoreg.search.genetic import Generation

MAGIC = b"photoreg checkpoint 1 "
"""What a saved checkpoint begins with; a digest of the rest follows."""


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """A refinement after one generation, or in the polish.

    Of the polish only its beginning is saved: it takes a second or two, and repeated it
    ends in the same cameras.
    """

    problem: str
    """Digest of mesh, photos, cameras, settings and freedom; see ``problem_digest``."""
    phase: Literal["search", "polish"]
    """What was going on."""
    generations: int
    """Generations so far, over all restarts."""
    elapsed_s: float
    """Seconds spent so far."""
    search: Generation
    """The search, after its last generation."""
    hidden_from: Float[np.ndarray, "g"] | None = None
    """Genes of the cameras from which hidden points were last looked for; None: the
    start."""

    def to_bytes(self) -> bytes:
        """The checkpoint for a file or a database; a digest guards it against damage."""
        search = self.search
        body = {
            "problem": self.problem,
            "phase": self.phase,
            "generations": self.generations,
            "elapsed_s": self.elapsed_s,
            "hidden_from": _packed(self.hidden_from),
            "restart": search.restart,
            "generation": search.generation,
            "genes": _packed(search.genes),
            "costs": _packed(search.costs),
            "best_genes": _packed(search.best_genes),
            "best_cost": search.best_cost,
            "evaluations": search.evaluations,
            "unchanged": search.unchanged,
            "stop": search.stop,
            "random_state": dict(search.random_state),
        }
        text = json.dumps(body).encode()
        return MAGIC + hashlib.sha256(text).hexdigest().encode() + b"\n" + text

    @classmethod
    def from_bytes(cls, kept: bytes) -> "Checkpoint":
        """Reads what ``to_bytes`` wrote.

        Raises:
            InputError: if it is something else, or damaged.
        """
        head, _, text = bytes(kept).partition(b"\n")
        if not head.startswith(MAGIC):
            raise InputError(
                "This is not a kept search of this version of photoreg; start the "
                "refinement anew."
            )
        if head[len(MAGIC) :] != hashlib.sha256(text).hexdigest().encode():
            raise InputError("The kept search is damaged; start the refinement anew.")
        try:
            return cls._of_body(json.loads(text))
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise InputError(
                f"The kept search cannot be read ({error!r}); start the refinement anew."
            ) from error

    @classmethod
    def _of_body(cls, body: dict[str, Any]) -> "Checkpoint":
        genes, costs = _unpacked(body["genes"], 2), _unpacked(body["costs"], 1)
        best = _unpacked(body["best_genes"], 1)
        hidden_from = body["hidden_from"]
        if hidden_from is not None:
            hidden_from = _unpacked(hidden_from, 1)
        if len(costs) != len(genes) or best.shape != genes.shape[1:]:
            raise ValueError("the population's arrays do not match")
        if body["phase"] not in ("search", "polish"):
            raise ValueError(f"{body['phase']} is no phase")
        if body["stop"] not in (None, "generations", "cost level", "stagnation"):
            raise ValueError(f"{body['stop']} is no reason to stop")
        # numpy refuses what is not its state.
        np.random.PCG64().state = body["random_state"]
        search = Generation(
            restart=int(body["restart"]),
            generation=int(body["generation"]),
            genes=genes,
            costs=costs,
            best_genes=best,
            best_cost=float(body["best_cost"]),
            evaluations=int(body["evaluations"]),
            unchanged=int(body["unchanged"]),
            stop=body["stop"],
            random_state=body["random_state"],
        )
        return cls(
            str(body["problem"]),
            body["phase"],
            int(body["generations"]),
            float(body["elapsed_s"]),
            search,
            hidden_from,
        )

    def require(self, problem: str) -> None:
        """Checks that the checkpoint is of this problem.

        Raises:
            InputError: if it is of another one.
        """
        if self.problem != problem:
            raise InputError(
                "The kept search began with another mesh, other photos, cameras or "
                "settings; bring those back, or start the refinement anew."
            )


def problem_digest(
    mesh: Mesh,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    config: object,
    freedom: Freedom,
) -> str:
    """A digest of all that decides a refinement's answer.

    Large arrays are sampled: it guards against mistakes, not against forgery.
    """
    digest = hashlib.sha256(repr((config, freedom)).encode())
    for name, value in _changed_new_settings(config):
        digest.update(f"{name}={value!r}".encode())
    for array in (mesh.vertices, mesh.faces):
        _add(digest, array)
    for photo in photos:
        _add(digest, photo.pixels)
        if photo.mask is not None:
            _add(digest, photo.mask)
    for camera in cameras:
        for array in (camera.K, camera.R_cam_world, camera.t_cam_world):
            _add(digest, array)
        if not camera.lens.is_ideal:
            digest.update(repr(camera.lens).encode())
    # Without lenses the digest is the same as before there were any.
    for i, held in enumerate(freedom.held):
        if held.lens:
            digest.update(f"lens {i} held".encode())
    for i in freedom.cropped:
        digest.update(f"photo {i} cropped".encode())
    return digest.hexdigest()


def _changed_new_settings(config: object, prefix: str = "") -> list[tuple[str, object]]:
    """Names and values of settings that ``repr`` leaves out and that were changed.

    A new setting must not invalidate searches that were saved without it: as long as it
    has its default, it is left out.
    """
    changed = []
    if dataclasses.is_dataclass(config):
        for field in dataclasses.fields(config):
            name, value = prefix + field.name, getattr(config, field.name)
            if not field.repr and value != field.default:
                changed.append((name, value))
            changed += _changed_new_settings(value, f"{name}.")
    return changed


def _add(digest: Any, array: np.ndarray) -> None:
    digest.update(repr((array.shape, array.dtype.str)).encode())
    flat = array.reshape(-1)
    step = max(1, len(flat) // 100_003)
    digest.update(np.ascontiguousarray(flat[::step]).tobytes())


def _packed(array: np.ndarray | None) -> dict[str, Any] | None:
    if array is None:
        return None
    exact = np.ascontiguousarray(array, dtype="<f8")
    return {
        "shape": list(exact.shape),
        "float64": base64.b64encode(exact.tobytes()).decode(),
    }


def _unpacked(packed: dict[str, Any], n_dimensions: int) -> np.ndarray:
    shape = tuple(int(side) for side in packed["shape"])
    if len(shape) != n_dimensions or min(shape) < 1:
        raise ValueError(f"an array of shape {shape} where {n_dimensions}-D was due")
    flat = np.frombuffer(base64.b64decode(packed["float64"], validate=True), "<f8")
    array = flat.reshape(shape).astype(np.float64)
    if np.isnan(array).any():
        raise ValueError("an array holds NaN")
    return array
