"""The object with its photos, or their disagreement, laid on, a few times a second.

Each face takes the photo that sees it most squarely, at the place where the camera of
the moment puts it. That needs no unwrapping and no baking, and the seams between the
photos close as the cameras come right. The photos themselves are named by address: a
browser fetches them once.
"""

from collections.abc import Sequence

import numpy as np

from app.engine.glb_file import GlbFile
from app.model.camera_moves import DisplayFrame
from app.model.messages import SMALL_PX
from app.model.pictures import Surface
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Photo
from photoreg.overlay.disagreement_map import CLAY, SurfaceSight, vertex_colours


class LiveSurface:
    """Draws the surface under changing cameras; what does not change is kept."""

    def __init__(
        self,
        mesh: Mesh,
        photos: Sequence[Photo],
        addresses: Sequence[str],
        frame: DisplayFrame,
    ) -> None:
        """Makes ready.

        Args:
            mesh: The surface in few faces: a browser must read them while the picture
                lasts.
            photos: The photos.
            addresses: Where a page finds them.
            frame: The page's, that of the whole mesh.
        """
        self._sight = SurfaceSight(mesh, photos, SMALL_PX)
        self._addresses = addresses
        shown = self._sight.mesh
        self._positions = frame.to_page(shown.vertices).astype("<f4")
        self._faces = shown.faces

    def glb(self, cameras: Sequence[Camera], surface: Surface) -> bytes:
        """The surface in page axes as a GLB file, drawn without light."""
        if surface == "photos":
            return self._with_photos(cameras)
        levels = self._sight.disagreement(cameras)
        return self._with_colours(vertex_colours(levels))

    def _with_photos(self, cameras: Sequence[Camera]) -> bytes:
        pixels, cosines = self._sight.look(cameras)
        # A face belongs to a photo that sees all its corners.
        squarely = cosines[:, self._faces].min(axis=2)
        choice = np.argmax(squarely, axis=0)
        choice[squarely.max(axis=0) <= 0.0] = -1
        file = GlbFile()
        position = file.positions(self._positions)
        for i, photo in enumerate(self._sight.photos):
            faces = self._faces[choice == i]
            if len(faces) == 0:
                continue
            # glTF's (0, 0) is the corner of the first pixel, ours its centre.
            uv = (pixels[i] + 0.5) / (photo.width, photo.height)
            # Beyond the photo lie only vertices of faces that are not its.
            share = np.nan_to_num(np.clip(uv, 0.0, 1.0), nan=0.0)
            file.primitive(
                {"POSITION": position, "TEXCOORD_0": file.shares(share)},
                faces,
                file.picture_at(self._addresses[i]),
            )
        rest = self._faces[choice < 0]
        if len(rest):
            file.primitive({"POSITION": position}, rest, file.plain(CLAY))
        return file.content()

    def _with_colours(self, colours: np.ndarray) -> bytes:
        file = GlbFile()
        # Colours of vertices are linear in glTF.
        linear = (colours / 255.0) ** 2.2
        rgba = np.column_stack([linear, np.ones(len(linear))])
        file.primitive(
            {
                "POSITION": file.positions(self._positions),
                "COLOR_0": file.floats(rgba),
            },
            self._faces,
            file.plain((255, 255, 255)),
        )
        return file.content()
