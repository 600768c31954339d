"""The 3-D scene: writes the state into viser's nodes and reads nothing back.

Nodes: /solid (clay or textured model), /clear (the translucent mesh of look-through),
/cameras (a frustum a photo, and the gizmo). Each browser hides what its own view does
not want; see viewport.
"""

from collections.abc import Callable

import numpy as np
import viser

from app.model.camera_moves import DisplayFrame
from app.model.pictures import Cloud
from app.model.state import State
from app.scene.frusta import SELECTED_COLOUR, Frusta
from app.scene.gizmos import Gizmos, Moved
from app.scene.markers import Markers, Pull
from app.scene.own_colours import has_own_colours, own_colours_glb
from app.web.controls import put
from photoreg.geometry.mesh import Mesh

CLAY = (160, 132, 108)
CLOUD_COLOUR = (232, 163, 61)
CLOUD_SIZE = 0.014
"""In units of the page, where the object is 2 across."""

LINE_COLOUR = (255, 64, 190)
SORTED_DEG = 12.0
"""The order of the faces holds for views this near to the one it was made for."""

N_OUTWARD_RAYS = 400
OUTWARD_SHARE = 0.96


class SceneNodes:
    """The shared nodes of the page, kept as the state has them."""

    def __init__(
        self,
        server: viser.ViserServer,
        on_gizmo: Moved,
        on_marker: Callable[[Pull], None],
    ) -> None:
        """``on_gizmo`` and ``on_marker`` are called as one of them is dragged."""
        self._server = server
        self.frame = DisplayFrame()
        self._mesh: Mesh | None = None
        self._up: tuple[float, float, float] | None = None
        self._texture: object = None
        self._textured: viser.GlbHandle | None = None
        self._surfaces: list[viser.GlbHandle] = []
        self._surface_glb: bytes | None = None
        self._surface_count = 0
        self._clay: viser.MeshHandle | None = None
        self._own: viser.GlbHandle | None = None
        self._clear: viser.MeshHandle | None = None
        scene = server.scene
        self.markers = Markers(scene, on_marker)
        for name in ("/solid", "/clear", "/cameras"):
            scene.add_frame(name, show_axes=False)
        self._sorted_for: np.ndarray | None = None
        self._faces: np.ndarray | None = None
        self._lines: viser.LineSegmentsHandle | None = None
        self._segments: np.ndarray | None = None
        self.gizmos = Gizmos(scene, on_gizmo)
        self.frusta = Frusta(server)
        self._cloud: viser.PointCloudHandle | None = None
        self._cloud_of: Cloud | None = None

    def show(self, state: State) -> None:
        """Makes the nodes as ``state`` has them; sends only what changed."""
        self._show_mesh(state)
        self._show_lines(state)
        self._show_surface(state)
        self._show_texture(state)
        self._show_cloud(state.cloud)
        self.frusta.show(state, self.frame)
        self.gizmos.show(state, self.frame)
        self.markers.show(state, self.frame)

    def _show_mesh(self, state: State) -> None:
        document = state.document
        if document.up != self._up:
            self._up = document.up
            self._server.scene.set_up_direction(document.up)
        if document.display_mesh is not self._mesh:
            self._mesh = document.display_mesh
            for node in (self._clay, self._own, self._clear):
                if node is not None:
                    node.remove()
            self._clay = self._own = self._clear = None
            if self._mesh is not None and document.mesh is not None:
                self.frame = DisplayFrame.of(document.mesh)
                vertices = self.frame.to_page(self._mesh.vertices)
                self._clay = self._server.scene.add_mesh_simple(
                    "/solid/clay", vertices, self._mesh.faces, color=CLAY, side="double"
                )
                if has_own_colours(document.mesh):
                    glb = own_colours_glb(document.mesh, self._mesh, self.frame)
                    self._own = self._server.scene.add_glb("/solid/own", glb)
                # Seen through, the far side would only confuse.
                faces = outward_faces(self._mesh)
                self._faces = self._mesh.faces if faces is None else faces
                self._sorted_for = None
                self._clear = self._server.scene.add_mesh_simple(
                    "/clear/clay",
                    vertices,
                    self._faces,
                    color=CLAY,
                    side="double" if faces is None else "front",
                    opacity=state.mesh_opacity,
                    cast_shadow=False,
                )
        if self._clear is not None:
            self._sort_faces(state)
            style = state.through_style
            put(self._clear, "opacity", state.mesh_opacity)
            put(self._clear, "visible", style in ("surface", "wireframe"))
            put(self._clear, "wireframe", style == "wireframe")
            colour = SELECTED_COLOUR if style == "wireframe" else CLAY
            put(self._clear, "color", colour)

    def _sort_faces(self, state: State) -> None:
        """Lets the translucent mesh be drawn from near to far for the photo's camera.

        Then what is nearer hides what is farther; in any other order two layers of the
        surface shine through each other, face by face.
        """
        entry = state.selected_photo
        if entry is None or self._faces is None or self._clear is None:
            return
        position = self.frame.pose(entry.camera)[1]
        direction = position / max(float(np.linalg.norm(position)), 1e-9)
        known = self._sorted_for
        if known is not None and known @ direction > np.cos(np.radians(SORTED_DEG)):
            return
        self._sorted_for = direction
        centres = self._clear.vertices[self._faces].mean(axis=1)
        distance = ((centres - position) ** 2).sum(axis=1)
        self._clear.faces = self._faces[np.argsort(distance)]

    def _show_lines(self, state: State) -> None:
        lines = None if state.drawn is None else state.drawn.lines
        wanted = state.through_style == "lines" and lines is not None and len(lines) > 0
        if wanted and lines is not self._segments and lines is not None:
            self._segments = lines
            points = self.frame.to_page(lines).astype(np.float32)
            if self._lines is None:
                self._lines = self._server.scene.add_line_segments(
                    "/clear/lines",
                    points,
                    colors=LINE_COLOUR,
                    thickness=1.5,
                    thickness_units="screen",
                )
            else:
                self._lines.points = points
        if self._lines is not None:
            put(self._lines, "visible", wanted)

    def _show_cloud(self, cloud: Cloud | None) -> None:
        if cloud is self._cloud_of:
            return
        self._cloud_of = cloud
        if self._cloud is not None:
            # Kept for the next run: a new one has its shader compiled again, for which
            # a browser without a graphics card stands still for half a second.
            put(self._cloud, "visible", cloud is not None)
        if cloud is None:
            return
        points = self.frame.to_page(cloud.centers.reshape(-1, 3)).astype(np.float32)
        if self._cloud is not None and self._cloud.points.shape == points.shape:
            self._cloud.points = points
            return
        self._cloud = self._server.scene.add_point_cloud(
            "/cameras/population",
            points,
            CLOUD_COLOUR,
            point_size=CLOUD_SIZE,
            point_shape="circle",
        )

    def _show_surface(self, state: State) -> None:
        """Shows what the object wears; the node before stays until the next one comes.

        A browser needs a moment to read a model: taken away at once, the old one would
        leave a gap.
        """
        glb = state.surface_glb
        if state.worn == "clay" or glb is None:
            for node in self._surfaces:
                node.remove()
            self._surfaces, self._surface_glb = [], None
            return
        if glb is self._surface_glb:
            return
        self._surface_glb = glb
        while len(self._surfaces) > 1:
            self._surfaces.pop(0).remove()
        self._surface_count += 1
        name = f"/solid/run-{self._surface_count % 3}"
        self._surfaces.append(self._server.scene.add_glb(name, glb))

    def _show_texture(self, state: State) -> None:
        if state.texture is not self._texture:
            self._texture = state.texture
            if self._textured is not None:
                self._textured.remove()
                self._textured = None
            if state.texture is not None:
                self._textured = self._server.scene.add_glb(
                    "/solid/textured", state.texture.glb
                )
        is_worn = bool(self._surfaces)
        textured = self._textured is not None and state.show_texture and not is_worn
        if self._textured is not None:
            put(self._textured, "visible", textured)
        covered = textured or is_worn
        wears_own = self._own is not None and state.show_own_colours
        if self._own is not None:
            put(self._own, "visible", wears_own and not covered)
        if self._clay is not None:
            put(self._clay, "visible", not covered and not wears_own)


def outward_faces(mesh: Mesh) -> np.ndarray | None:
    """The faces, wound so that they look outwards; None where that has no meaning.

    Rays from all around meet the outside first: nearly all of them must agree.
    """
    k = np.arange(N_OUTWARD_RAYS) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * k / N_OUTWARD_RAYS), k * np.pi * (1 + 5**0.5)
    around = np.column_stack(
        [
            np.sin(polar) * np.cos(azimuth),
            np.sin(polar) * np.sin(azimuth),
            np.cos(polar),
        ]
    )
    faces, _ = mesh.first_hits(mesh.centroid + mesh.diagonal * around, -around)
    met = faces >= 0
    if not met.any():
        return None
    facing = np.einsum("ij,ij->i", mesh.face_normals[faces[met]], around[met]) > 0.0
    if facing.mean() > OUTWARD_SHARE:
        return mesh.faces
    return mesh.faces[:, ::-1] if facing.mean() < 1.0 - OUTWARD_SHARE else None
