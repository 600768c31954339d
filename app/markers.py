"""Numbered markers of the selected photo's points, on the surface."""

import numpy as np
import viser

from app.placement import DisplayFrame
from app.state import PointPair, State

RADIUS = 0.016
"""In page units; the mesh's diagonal is 2."""

WHOLE, PENDING, WRONG = (45, 212, 191), (255, 210, 77), (255, 95, 86)


class Markers:
    """A small ball and a number for each point on the surface."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._nodes: dict[int, tuple[object, list[viser.SceneNodeHandle]]] = {}
        scene.add_frame("/points", show_axes=False)

    def show(self, state: State, frame: DisplayFrame) -> None:
        """Makes the markers as ``state`` has them; sends only what changed."""
        entry = state.selected_photo
        pairs = entry.pairs if entry is not None else ()
        wrong = _wrong(state)
        wanted = {
            pair.number: (pair.world, frame, _colour(pair, wrong))
            for pair in pairs
            if pair.world is not None
        }
        for number in [
            n for n, (key, _) in self._nodes.items() if wanted.get(n) != key
        ]:
            for node in self._nodes.pop(number)[1]:
                node.remove()
        for number, key in wanted.items():
            if number in self._nodes:
                continue
            world, _, colour = key
            assert world is not None
            x, y, z = (float(v) for v in frame.to_page(np.array(world)))
            ball = self._scene.add_icosphere(
                f"/points/{number}",
                radius=RADIUS,
                color=colour,
                position=(x, y, z),
                cast_shadow=False,
                receive_shadow=False,
            )
            label = self._scene.add_label(
                f"/points/{number}/label",
                str(number),
                position=(RADIUS, RADIUS, 0.0),
                anchor="bottom-left",
                font_screen_scale=0.9,
            )
            self._nodes[number] = (key, [label, ball])


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
