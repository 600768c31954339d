"""The 3-D scene: writes the state into viser's nodes and reads nothing back.

Nodes: /solid (clay or textured model), /clear (the translucent mesh of look-through),
/cameras (a frustum a photo, and the gizmo). Each browser hides what its own view does
not want; see viewport.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
import viser
import viser.transforms as vtf

from app.controls import put
from app.markers import Markers
from app.placement import DisplayFrame, frustum_corners, orbit_axes, orbited
from app.state import PhotoEntry, State
from photoreg.camera import Camera
from photoreg.mesh import Mesh

CLAY = (160, 132, 108)
SELECTED_COLOUR = (45, 190, 175)
FRUSTUM_COLOUR = (140, 150, 170)
GHOST_COLOUR = (120, 120, 130)
IMAGE_SIDE_PX = 640
LINE_COLOUR = (255, 64, 190)
GIZMO_PX = 105.0
ORBIT_PX = 190.0
SORTED_DEG = 12.0
"""The order of the faces holds for views this near to the one it was made for."""

N_OUTWARD_RAYS = 400
OUTWARD_SHARE = 0.96


class Scene:
    """The shared nodes of the page, kept as the state has them."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self.frame = DisplayFrame()
        self._holder: int | None = None
        self._mesh: Mesh | None = None
        self._up: tuple[float, float, float] | None = None
        self._frusta: list[Frustum] = []
        self._ghosts: list[viser.LineSegmentsHandle] = []
        self._texture: object = None
        self._textured: viser.GlbHandle | None = None
        self._run_is_shown = False
        self._surfaces: list[viser.GlbHandle] = []
        self._surface_glb: bytes | None = None
        self._surface_count = 0
        self._ghosts_of: tuple[Camera, ...] = ()
        self._clay: viser.MeshHandle | None = None
        self._clear: viser.MeshHandle | None = None
        scene = server.scene
        self.markers = Markers(scene)
        for name in ("/solid", "/clear", "/cameras"):
            scene.add_frame(name, show_axes=False)
        self._sorted_for: np.ndarray | None = None
        self._faces: np.ndarray | None = None
        self._lines: viser.LineSegmentsHandle | None = None
        self._segments: np.ndarray | None = None
        # Two gizmos, of which one is shown: at the camera, and about the object.
        self.gizmo = scene.add_transform_controls(
            "/cameras/gizmo",
            scale=GIZMO_PX,
            fixed=True,
            depth_test=False,
            line_width=3.0,
            visible=False,
        )
        self.orbit = scene.add_transform_controls(
            "/cameras/orbit",
            scale=ORBIT_PX,
            fixed=True,
            depth_test=False,
            line_width=4.0,
            disable_axes=True,
            disable_sliders=True,
            visible=False,
        )
        self._orbit_rest = np.eye(3)
        self._orbit_start: tuple[Camera, np.ndarray] | None = None

    def on_gizmo(
        self, moved: Callable[[str, int, Callable[[Camera], Camera]], None]
    ) -> None:
        """Calls ``moved(phase, browser, change)`` as a gizmo is dragged.

        ``change`` makes the camera where the hand has it from the one in force.
        """

        @self.gizmo.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            self._hold(event)
            rotation = vtf.SO3(event.target.wxyz).as_matrix()
            position = np.array(event.target.position)
            moved(
                event.phase,
                event.client_id or 0,
                lambda camera: self.frame.with_pose(camera, rotation, position),
            )

        @self.orbit.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            self._hold(event)
            wxyz = np.array(event.target.wxyz)
            moved(
                event.phase,
                event.client_id or 0,
                lambda camera: self._orbited(camera, wxyz),
            )
            if event.phase == "end":
                self._orbit_start = None

    def let_go(self, browser: int) -> None:
        """Frees the gizmo that a browser held when it went away."""
        if self._holder == browser:
            self._holder = None
            self._orbit_start = None

    def _hold(self, event: viser.TransformControlsEvent) -> None:
        self._holder = None if event.phase == "end" else event.client_id

    def _orbited(self, camera: Camera, wxyz: np.ndarray) -> Camera:
        """The camera orbited as far as the gizmo was turned since it was taken."""
        if self._orbit_start is None:
            self._orbit_start = (camera, self._orbit_rest)
        start, rest = self._orbit_start
        # From the start each time: steps would add up their rounding.
        turn = vtf.SO3(wxyz).as_matrix() @ rest.T
        carried = orbited(start, self.frame.to_world(np.zeros(3)), turn)
        return dataclasses.replace(
            camera,
            R_cam_world=carried.R_cam_world,
            t_cam_world=carried.t_cam_world,
        )

    def show(self, state: State, lines: np.ndarray | None = None) -> None:
        """Makes the nodes as ``state`` has them; sends only what changed.

        ``lines`` are the newest silhouette and creases, (s, 2, 3) in world axes.
        """
        self._show_mesh(state)
        self._show_lines(state, lines)
        self._show_texture(state)
        self._show_frusta(state)
        self._show_gizmo(state)
        self.markers.show(state, self.frame)

    def _show_mesh(self, state: State) -> None:
        document = state.document
        if document.up != self._up:
            self._up = document.up
            self._server.scene.set_up_direction(document.up)
        if document.display_mesh is not self._mesh:
            self._mesh = document.display_mesh
            for node in (self._clay, self._clear):
                if node is not None:
                    node.remove()
            self._clay = self._clear = None
            if self._mesh is not None and document.mesh is not None:
                self.frame = DisplayFrame.of(document.mesh)
                vertices = self.frame.to_page(self._mesh.vertices)
                self._clay = self._server.scene.add_mesh_simple(
                    "/solid/clay", vertices, self._mesh.faces, color=CLAY, side="double"
                )
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

    def _show_lines(self, state: State, lines: np.ndarray | None) -> None:
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

    def show_surface(self, glb: bytes | None) -> None:
        """Shows the surface of a run; the node before stays until the next one comes.

        A browser needs a moment to read a model: taken away at once, the old one would
        leave a gap.
        """
        if not self._run_is_shown or glb is None:
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
        textured = self._textured is not None and state.show_texture
        if self._textured is not None:
            put(self._textured, "visible", textured)
        self._run_is_shown = state.run.status != "idle" and state.surface != "clay"
        covered = textured or (self._run_is_shown and bool(self._surfaces))
        if self._textured is not None and self._run_is_shown:
            put(self._textured, "visible", False)
        if self._clay is not None:
            put(self._clay, "visible", not covered)

    def _show_frusta(self, state: State) -> None:
        photos = state.photos
        while len(self._frusta) > len(photos):
            self._frusta.pop().remove()
        for i, entry in enumerate(photos):
            if i == len(self._frusta):
                self._frusta.append(Frustum(self._server, f"/cameras/{i}"))
            self._frusta[i].show(entry, self.frame, i == state.selected)
        starts = state.run.start if state.run.status != "idle" else ()
        self._show_ghosts(starts)

    def _show_ghosts(self, cameras: tuple[Camera, ...]) -> None:
        """Thin outlines where the cameras were when the refinement started."""
        if cameras is self._ghosts_of:
            return
        self._ghosts_of = cameras
        for ghost in self._ghosts:
            ghost.remove()
        self._ghosts = []
        for i, camera in enumerate(cameras):
            rotation, position = self.frame.pose(camera)
            corners = frustum_corners(camera) @ rotation.T + position
            self._ghosts.append(
                self._server.scene.add_line_segments(
                    f"/cameras/start-{i}",
                    frustum_lines(position, corners),
                    colors=GHOST_COLOUR,
                    thickness=1.0,
                    thickness_units="screen",
                )
            )

    def _show_gizmo(self, state: State) -> None:
        entry = state.selected_photo
        visible = entry is not None and state.run.status == "idle"
        put(self.gizmo, "visible", visible and state.gizmo == "move")
        put(self.orbit, "visible", visible and state.gizmo == "orbit")
        if entry is None or self._holder is not None:
            return  # The hand that drags it is ahead of the state.
        rotation, position = self.frame.pose(entry.camera)
        self.gizmo.wxyz = vtf.SO3.from_matrix(rotation).wxyz
        self.gizmo.position = position
        self._orbit_rest = orbit_axes(position, np.array(state.document.up))
        self.orbit.wxyz = vtf.SO3.from_matrix(self._orbit_rest).wxyz


class Frustum:
    """One photo in the scene: lines from the camera's centre, and the photo itself.

    Made from K by hand; viser's own frustum has no principal point.
    """

    def __init__(self, server: viser.ViserServer, name: str) -> None:
        self._scene = server.scene
        self._name = name
        self._root = server.scene.add_frame(name, show_axes=False)
        self._lines: viser.LineSegmentsHandle | None = None
        self._image: viser.ImageHandle | None = None
        self._photo: object = None
        self._K: np.ndarray | None = None

    def show(self, entry: PhotoEntry, frame: DisplayFrame, selected: bool) -> None:
        """Makes the nodes as ``entry`` has them."""
        camera = entry.camera
        rotation, position = frame.pose(camera)
        self._root.wxyz = vtf.SO3.from_matrix(rotation).wxyz
        self._root.position = position
        if (
            self._photo is not entry.photo
            or self._K is None
            or not np.array_equal(self._K, camera.K)
        ):
            self._draw(entry)
        assert self._lines is not None
        assert self._image is not None
        colour = SELECTED_COLOUR if selected else FRUSTUM_COLOUR
        if not np.array_equal(self._lines.colors, colour):
            self._lines.colors = np.array(colour, dtype=np.uint8)
        put(self._lines, "thickness", 3.0 if selected else 1.6)
        put(self._image, "visible", entry.enabled)

    def _draw(self, entry: PhotoEntry) -> None:
        camera = entry.camera
        corners = frustum_corners(camera)
        lines = frustum_lines(np.zeros(3), corners)
        width = float(np.linalg.norm(corners[1] - corners[0]))
        height = float(np.linalg.norm(corners[3] - corners[0]))
        centre = corners.mean(axis=0)
        if self._lines is None:
            self._lines = self._scene.add_line_segments(
                f"{self._name}/lines",
                lines,
                colors=FRUSTUM_COLOUR,
                thickness=1.6,
                thickness_units="screen",
            )
        else:
            self._lines.points = lines.astype(np.float32)
        if self._photo is not entry.photo or self._image is None:
            self._image = self._scene.add_image(
                f"{self._name}/photo",
                entry.photo.resized(IMAGE_SIDE_PX).pixels,
                width,
                height,
                format="jpeg",
                jpeg_quality=85,
                cast_shadow=False,
                receive_shadow=False,
                position=centre,
            )
        else:
            self._image.render_width = width
            self._image.render_height = height
            self._image.position = centre
        self._photo, self._K = entry.photo, camera.K

    def remove(self) -> None:
        """Takes the nodes out of the scene."""
        self._root.remove()


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


def frustum_lines(apex: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Segments (8, 2, 3): apex to each corner, and around the corners."""
    spokes = [[apex, corner] for corner in corners]
    sides = [[corners[i], corners[(i + 1) % 4]] for i in range(4)]
    return np.array(spokes + sides)
