"""Numbered markers of the selected photo's points, on the surface, to be dragged."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import viser

from app.model.camera_moves import DisplayFrame
from app.model.state import PointPair, State
from app.web.controls import guarded, put

RADIUS = 0.016
"""In page units; the mesh's diagonal is 2."""

WHOLE, PENDING, WRONG = (45, 212, 191), (255, 210, 77), (255, 95, 86)


class Pull(NamedTuple):
    """A marker in the hand of somebody."""

    client: viser.ClientHandle
    number: int
    phase: str
    """"start", "update" or "end"."""
    origin: np.ndarray
    """Of the ray, in page axes, on which the marker's centre should lie."""
    direction: np.ndarray


class Markers:
    """A small ball and a number for each point on the surface."""

    def __init__(self, scene: viser.SceneApi, on_pull: Callable[[Pull], None]) -> None:
        """``on_pull`` is called as a marker is dragged."""
        self._scene = scene
        self._balls: dict[int, viser.IcosphereHandle] = {}
        self._grips: dict[int, np.ndarray] = {}
        self._on_pull = on_pull
        scene.add_frame("/points", show_axes=False)

    def show(self, state: State, frame: DisplayFrame) -> None:
        """Makes the markers as ``state`` has them; sends only what changed.

        A marker that moves stays the same node: it may be in somebody's hand.
        """
        entry = state.selected_photo
        pairs = entry.pairs if entry is not None else ()
        wanted = {pair.number: pair for pair in pairs if pair.world is not None}
        for number in self._balls.keys() - wanted.keys():
            self._balls.pop(number).remove()
        wrong = _wrong(state)
        for number, pair in wanted.items():
            place = frame.to_page(np.array(pair.world))
            colour = _colour(pair, wrong)
            ball = self._balls.get(number)
            if ball is None:
                self._balls[number] = self._add(number, place, colour)
                continue
            if not np.array_equal(ball.position, place):
                ball.position = place
            put(ball, "color", colour)

    def _add(
        self, number: int, place: np.ndarray, colour: tuple[int, int, int]
    ) -> viser.IcosphereHandle:
        name = f"/points/{number}"
        ball = self._scene.add_icosphere(
            name,
            radius=RADIUS,
            color=colour,
            position=place,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._scene.add_label(
            f"{name}/label",
            str(number),
            position=(RADIUS, RADIUS, 0.0),
            anchor="bottom-left",
            font_screen_scale=0.9,
        )

        @ball.on_drag("left")
        @guarded
        def _(event: viser.SceneNodeDragEvent) -> None:
            if event.phase == "start":
                # The hand has the ball somewhere on its skin, not by its centre.
                self._grips[number] = ball.position - np.array(event.start_position)
            eye = np.array(event.client.camera.position)
            aim = np.array(event.end_position) + self._grips.get(number, 0.0)
            self._on_pull(Pull(event.client, number, event.phase, eye, aim - eye))

        return ball


def _wrong(state: State) -> set[int]:
    solution = state.current_solution
    if solution is None or solution.resection is None:
        return set()
    inliers = solution.resection.inliers
    return {
        p.number for p, good in zip(solution.pairs, inliers, strict=True) if not good
    }


def _colour(pair: PointPair, wrong: set[int]) -> tuple[int, int, int]:
    if pair.number in wrong:
        return WRONG
    return WHOLE if pair.is_whole else PENDING
