"""The first view: object, cameras and the arrows of their gizmos, all in the frame."""

import numpy as np
import pytest

from app.engine.warm_up import toy_scene
from app.model.camera_moves import DisplayFrame
from app.model.state import Document, PhotoEntry, State
from app.scene.home_view import home_view

FOV_RAD = np.radians(14.0)


@pytest.mark.parametrize("aspect", [0.6, 0.8, 1.5, 2.2])
@pytest.mark.parametrize(("gizmo_share", "alone"), [(0.1, 0), (0.2, 0), (0.2, 1)])
def test_what_is_shown_fills_the_frame(aspect, gizmo_share, alone):
    """Object, cameras and their gizmos; or the object alone."""
    mesh, photos, cameras = toy_scene()
    entries = tuple(map(PhotoEntry, photos, cameras))
    state = State(document=Document(mesh, mesh, entries))
    frame = DisplayFrame.of(mesh)
    position, target = home_view(state, frame, FOV_RAD, aspect, gizmo_share, alone)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, state.document.up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])

    def on_canvas(points: np.ndarray) -> np.ndarray:
        """In heights of the canvas, from its middle."""
        x, y, depth = axes @ (points - position).T
        return 0.5 * np.column_stack([x, y]) / depth[:, None] / np.tan(0.5 * FOV_RAD)

    shown = [on_canvas(frame.to_page(mesh.vertices))]
    for camera in () if alone else cameras:
        rotation, centre = frame.pose(camera)
        shown.append(on_canvas(centre[None]))
        shown.append(shown[-1] + gizmo_share * rotation.T @ axes[:2].T)
    sides = np.concatenate(shown) / (0.5 * np.array([aspect, 1.0]))
    assert np.abs(sides).max() < 0.96, f"up to {np.abs(sides).max():.2f} of the canvas"
    assert np.abs(sides).max() > 0.85, "and no smaller than need be"


@pytest.mark.parametrize(("aspect", "gizmo_share"), [(0.3, 0.33), (0.1, 0.2), (4, 0.6)])
def test_arrows_that_are_too_long_for_the_canvas_leave_the_scene_in_it(
    aspect, gizmo_share
):
    mesh, photos, cameras = toy_scene()
    state = State(
        document=Document(mesh, mesh, tuple(map(PhotoEntry, photos, cameras)))
    )
    frame = DisplayFrame.of(mesh)
    position, target = home_view(state, frame, FOV_RAD, aspect, gizmo_share)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, state.document.up)
    right /= np.linalg.norm(right)
    centres = np.array([frame.pose(camera)[1] for camera in cameras])
    points = np.concatenate([frame.to_page(mesh.vertices), centres])
    axes = np.stack([right, np.cross(forward, right), forward])
    x, y, depth = axes @ (points - position).T
    assert (depth > 0.0).all()
    sides = np.column_stack([x / aspect, y]) / depth[:, None] / np.tan(0.5 * FOV_RAD)
    assert np.abs(sides).max() < 0.96, f"up to {np.abs(sides).max():.2f} of the canvas"
