"""The job that finds cameras without a click."""

import dataclasses
from collections.abc import Iterator, Sequence

from app.model.messages import CamerasFound, Working
from app.model.state import FoundCamera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.encoding import encode_jpeg
from photoreg.imaging.photo import Photo
from photoreg.overlay.pictures import pose_picture
from photoreg.placing.outcome import Box, Placement, PlacingStep
from photoreg.registration.find_cameras import find_cameras

PICTURE_PX = 320
TITLE = "Finding the cameras"


def finding(
    mesh: Mesh, photos: Sequence[Photo], boxes: Sequence[Box | None]
) -> Iterator[Working | CamerasFound]:
    """Finds the cameras of photos; stop iterating to cancel.

    Args:
        mesh: The surface.
        photos: The photos, with their masks.
        boxes: Around the object in each of them, where there is one.
    """
    hints = {
        photo.name: box
        for photo, box in zip(photos, boxes, strict=True)
        if box is not None
    }
    for event in find_cameras(mesh, photos, boxes=hints):
        if isinstance(event, PlacingStep):
            yield Working(f"{TITLE}: {event.step}", event.fraction)
        else:
            yield CamerasFound(
                tuple(
                    _pictured(mesh, photo, placement)
                    for photo, placement in zip(photos, event.placements, strict=True)
                )
            )


def _pictured(mesh: Mesh, photo: Photo, placement: Placement) -> FoundCamera:
    whole = dataclasses.replace(photo, mask=None)
    pictures = tuple(
        encode_jpeg(pose_picture(mesh, whole, camera, PICTURE_PX), 80)
        for camera in placement.candidates
    )
    return FoundCamera(
        photo.name,
        placement.grade,
        placement.sentence,
        placement.candidates,
        pictures,
    )
