"""The first view: where to stand so that object and cameras are read at a glance.

Pure geometry: no viser.
"""

import numpy as np

from app.model.camera_moves import DisplayFrame, frustum_corners
from app.model.state import State

AZIMUTHS_DEG = (0, -8, 8, -16, 16, -24, 24, -34, 34, -46, 46, -60, 60, -78, 78)
ELEVATIONS_DEG = (16, 20, 24, 28, 32, 36)
SHARE = 0.92
"""Share of the canvas that is filled, the gizmos included."""

OBJECT_POINTS = 400
LONGEST_ARROW = 0.7
"""Of half the canvas's shorter side: the most room that an arrow is given."""

OFF_CENTRE_PRICE = 0.35
"""How much larger the object must be to stand at the canvas's edge."""

COVER_PRICE = 5.0
"""How much larger the object must be for a camera to cover all of it."""


def home_view(
    state: State,
    frame: DisplayFrame,
    fov_rad: float,
    aspect: float,
    gizmo_share: float,
    alone: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Position and target, in page axes, from which everything is in the frame.

    From behind the cameras and above, so that the object's front and what the cameras
    look at are seen together; of many such views the one in which the object is
    large, near the middle, and not covered by a camera.

    Args:
        state: What is shown.
        frame: The page's frame.
        fov_rad: The view's vertical field of view.
        aspect: Width over height of the canvas.
        gizmo_share: How far the arrows of a camera's gizmo reach on the canvas, in
            heights of it; they are as long wherever the camera stands.
        alone: The cameras are not shown; the object alone fills the canvas, seen from
            their side.
    """
    # Where they are too long for the canvas, as upright on a tablet, they may be cut off.
    reach = min(2.0 * gizmo_share, LONGEST_ARROW * min(aspect, 1.0))
    reach *= np.tan(0.5 * fov_rad)
    up = np.array(state.document.up)
    mesh = state.document.display_mesh
    if mesh is None:
        thing = np.concatenate([np.eye(3), -np.eye(3)])
    else:
        step = max(1, len(mesh.vertices) // OBJECT_POINTS)
        thing = frame.to_page(mesh.vertices[::step])
    groups, arrows = [thing], [np.zeros_like(thing)]
    toward = np.zeros(3)
    for entry in state.document.photos:
        rotation, position = frame.pose(entry.camera)
        corners = frustum_corners(entry.camera) @ rotation.T + position
        if not alone:
            groups.append(np.vstack([position[None].repeat(3, axis=0), corners]))
            arrows.append(np.vstack([rotation.T, np.zeros_like(corners)]))
        toward += position / max(float(np.linalg.norm(position)), 1e-9)
    toward -= up * (toward @ up)
    if np.linalg.norm(toward) < 0.1:
        toward = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    toward /= np.linalg.norm(toward)
    aside = np.cross(up, toward)
    views = []
    # Alone it is seen as the photos see it, not from where it is largest.
    n_each = 1 if alone else None
    for azimuth in np.radians(AZIMUTHS_DEG[:n_each]):
        for elevation in np.radians(ELEVATIONS_DEG[:n_each]):
            level = np.cos(azimuth) * toward + np.sin(azimuth) * aside
            direction = np.cos(elevation) * level + np.sin(elevation) * up
            views.append(
                _fitting_view(groups, arrows, reach, direction, up, fov_rad, aspect)
            )
    _, position, target = min(views, key=lambda view: view[0])
    return position, target


def _fitting_view(
    groups: list[np.ndarray],
    arrows: list[np.ndarray],
    reach: float,
    direction: np.ndarray,
    up: np.ndarray,
    fov_rad: float,
    aspect: float,
) -> tuple[float, np.ndarray, np.ndarray]:
    """A view that just holds all points, centred: its badness, position and target.

    The first group is the object, the others are the cameras. Each point may bear an
    arrow, a direction in page axes, that is ``reach`` long on the canvas.
    """
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(direction, right), direction])
    slope = SHARE * np.tan(0.5 * fov_rad) * np.array([aspect, 1.0])
    cloud = np.concatenate(groups)
    beyond = reach * np.concatenate(arrows) @ axes[:2].T
    target, distance, seen = cloud.mean(axis=0), 1.0, cloud[:, :2]
    # In turn: the distance that fits, then the target amid what is seen from there.
    for _ in range(8):
        x, y, z = axes @ (cloud - target).T
        flat = np.column_stack([x, y])
        # To the right and the left, above and below.
        sides = [sign * flat / (slope - sign * beyond) for sign in (1.0, -1.0)]
        distance = float((np.maximum(*sides) + z[:, None]).max())
        seen = flat / (distance - z)[:, None] + beyond
        middle = 0.5 * (seen.max(axis=0) + seen.min(axis=0))
        target = target + distance * (middle @ axes[:2])
    # From here on in canvas sizes: -1 to 1 is the part that may be filled.
    seen = np.split(seen / slope, np.cumsum([len(group) for group in groups])[:-1])
    low, high = seen[0].min(axis=0), seen[0].max(axis=0)
    covered = 0.0
    for camera in seen[1:]:
        common = np.minimum(camera.max(axis=0), high) - np.maximum(
            camera.min(axis=0), low
        )
        covered += float(np.prod(np.maximum(common, 0.0) / (high - low)))
    size = float(np.sqrt(np.prod(high - low)))
    off_centre = float(np.linalg.norm(0.5 * (low + high)))
    badness = (1.0 + OFF_CENTRE_PRICE * off_centre + COVER_PRICE * covered) / size
    return badness, target + distance * direction, target
