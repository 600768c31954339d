"""A state of the app in which every word is hostile, as another's project may bring it."""

import dataclasses
import types
import typing
from typing import Any

import numpy as np

from app.engine.warm_up import toy_scene
from app.model.run import Run
from app.model.state import (
    Agreement,
    Document,
    Job,
    PhotoEntry,
    PointPair,
    Solution,
    State,
    Texture,
)
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.readiness import Readiness
from photoreg.report.cost_curve import CurvePoint
from photoreg.report.photo_comparison import PhotoComparison
from photoreg.resection.solver import Resection
from photoreg.texture.config import TextureConfig
from tests.robustness.lying_meshes import glb

SCRIPT = "window.hacked=(window.hacked??0)+1"
WORDS = (
    f"\"'><img src=x onerror={SCRIPT}><script>{SCRIPT}</script>"
    f"<iframe srcdoc='<script>parent.{SCRIPT}</script>'></iframe>"
    f'<b onclick="{SCRIPT}" onmouseover="{SCRIPT}">b</b>'
    "![shown](/nowhere/hostile.png) [link](javascript:alert(1)) | **x** `y` & \\"
)
"""Text that is script where it gets into HTML, an attribute or Markdown as it stands."""


def with_hostile_words(value: Any, hint: Any = Any) -> Any:
    """The value, with ``WORDS`` after every text in it that may be any text."""
    origin = typing.get_origin(hint)
    if origin is typing.Literal:
        return value
    if origin in (typing.Union, types.UnionType):
        arms = typing.get_args(hint)
        hint = next((a for a in arms if _is_a(value, a)), Any)
        origin = typing.get_origin(hint)
        if origin is typing.Literal:
            return value
    if isinstance(value, str):
        return value + WORDS
    if isinstance(value, tuple):
        parts = typing.get_args(hint) if origin is tuple else ()
        if not parts or parts[-1] is Ellipsis:
            parts = (parts[0] if parts else Any,) * len(value)
        return tuple(map(with_hostile_words, value, parts))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        hints = typing.get_type_hints(type(value))
        return dataclasses.replace(
            value,
            **{
                field.name: with_hostile_words(
                    getattr(value, field.name), hints[field.name]
                )
                for field in dataclasses.fields(value)
                if field.init and field.name != "config"
            },
        )
    return value


def _is_a(value: Any, hint: Any) -> bool:
    kind = typing.get_origin(hint) or hint
    if kind is typing.Literal:
        return value in typing.get_args(hint)
    return isinstance(kind, type) and isinstance(value, kind)


def hostile_document() -> Document:
    """Two photos of a rock with points, all with hostile names."""
    mesh, photos, cameras = toy_scene()
    entries = []
    for photo, camera in zip(photos, cameras, strict=True):
        points = mesh.vertices[::12][:8]
        pixels = points @ camera.P[:, :3].T + camera.P[:, 3]
        pixels = pixels[:, :2] / pixels[:, 2:]
        pairs = tuple(
            PointPair(i, (world[0], world[1], world[2]), (pixel[0], pixel[1]))
            for i, (world, pixel) in enumerate(
                zip(points.tolist(), pixels.tolist(), strict=True), 1
            )
        )
        entries.append(PhotoEntry(photo, camera, pairs=pairs))
    return with_hostile_words(Document(mesh, mesh, tuple(entries)))


def hostile_states() -> list[State]:
    """States that together show every panel's words: idle, at work, and to be reviewed."""
    document = hostile_document()
    names, cameras = [e.name for e in document.used], document.used_cameras
    entry, n = document.photos[0], len(document.photos[0].pairs)
    inliers = np.arange(n) > 0
    resection = Resection(
        camera=cameras[0],
        solved="pose",
        residuals_px=np.ones(n),
        inliers=inliers,
        rms_px=1.0,
        worst=0,
        expected_error_px=3.0,
        warnings=("Pair 1 does not",),
    )
    idle = State(
        document=document,
        solution=Solution(entry.photo, entry.pairs, resection, ""),
        readiness=Readiness(overlap=0.5, blind=("a",), alone=("b",), plain=("c",)),
        agreement=Agreement(1.0, 2.0, 0.5),
        texture=Texture(
            glb(),
            cameras,
            TextureConfig(),
            "Good.",
            b"",
            (("p", 0.5, (1, 2, 3)),),
        ),
        worker="At work",
        note="Done.",
        undo_name="Move",
        redo_name="Turn",
    )
    run = Run(
        status="review",
        number=1,
        began="2026-01-01 10:00",
        config=RegistrationConfig(),
        start=cameras,
        cameras=cameras,
        phase="polish",
        step="level 1",
        curve=(CurvePoint(0, 1.0, 1.0), CurvePoint(1, 0.5, 0.6)),
        start_cost=1.0,
        cost=0.5,
        expected_errors_px=(1.0, 2.0),
        grade="plausible",
        verdict="plausible: the outlines fit",
        outcome="It ended.",
        warnings=("Little overlap.",),
        standard_errors=("left: 1 px",),
        undetermined=("the focal length",),
    )
    idle = dataclasses.replace(
        with_hostile_words(dataclasses.replace(idle, document=Document())),
        document=document,
        solution=Solution(
            entry.photo, entry.pairs, with_hostile_words(resection), "No." + WORDS
        ),
        held=((names[0], "pose"),),
    )
    idle = dataclasses.replace(idle, texture=with_hostile_words(idle.texture))
    run = dataclasses.replace(with_hostile_words(run), photo_names=tuple(names))
    run = dataclasses.replace(run, freedom=idle.freedom)
    at_work = dataclasses.replace(run, status="running")
    unsolved = Solution(entry.photo, entry.pairs, None, "It fits nowhere." + WORDS)
    return [
        dataclasses.replace(idle, saving=""),
        idle,
        dataclasses.replace(
            idle, saving="", job=Job("Baking" + WORDS, can_stop=True), solution=unsolved
        ),
        dataclasses.replace(idle, saving="", run=at_work),
        dataclasses.replace(idle, saving="", run=run, runs=(run,)),
    ]


def hostile_comparison() -> PhotoComparison:
    """Before and after in a photo with a hostile name."""
    return PhotoComparison(
        name="left.png" + WORDS,
        carried="right.png" + WORDS,
        before=b"",
        after=b"",
        disagreement_before=b"",
        disagreement_after=b"",
        levels_before=1.0,
        levels_after=None,
    )
