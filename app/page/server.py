"""The page: a viser server, its panels and scene, and one thread that paints them.

Callbacks change the session; the painter alone writes to viser, newest state first,
so that nothing flickers however fast the changes come.
"""

import contextlib
import dataclasses
import io
import queue
import threading
import time
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import viser

from app.control.camera_claims import CameraClaims
from app.control.controller import Controller
from app.model.failures import is_news, log_failure
from app.model.markup import mounted
from app.model.session import Session, blinked, with_entry
from app.model.state import Job, Notice, State
from app.panels.align import AlignPanel
from app.panels.data import DataPanel
from app.panels.export import ExportPanel
from app.panels.find_cameras import FindCamerasPanel
from app.panels.meter import VERDICTS, meter_html
from app.panels.overlay import OverlayPanel
from app.panels.points import PointsPanel
from app.panels.project import ProjectPanel
from app.panels.refine import RefinePanel
from app.panels.view import ViewPanel
from app.scene.canvas import backdrop
from app.scene.markers import Pull
from app.scene.nodes import SceneNodes
from app.scene.viewport import Viewport
from app.web.access import AccessControl, start_viser
from app.web.bridge import Bridge, Values
from app.web.button_commands import ButtonCommands
from app.web.controls import (
    BRAND,
    guarded,
    guarded_client,
    has_left,
    notify,
    put,
    report,
)
from app.web.help import Help
from app.web.hints import button_hints
from app.web.layout import dock
from app.web.pending_messages import hear_out
from app.web.uploads import limit_uploads
from app.web.widgets import Tool, Tools
from photoreg.errors import PhotoregError
from photoreg.geometry.camera import Camera
from photoreg.limits import Limits
from photoreg.report.templates import part
from photoreg.words import in_words

PAINT_PERIOD_S = 1 / 30
PASSING_PERIOD_S = 0.25
"""What a run tells waits so long for the next picture, to be painted together with it: a
browser without a graphics card needs 20 to 50 ms of a core each time a word changes."""

PASSING = (
    *("run", "kept_search", "agreement", "notice"),
    *("drawn", "shows_other", "surface_glb", "cloud"),
)
"""The parts of the state that change all the time while a run goes on."""

BLINK_PERIOD_S = 0.6
SCENE_PERIOD_S = 0.5
"""Time between two states of the 3-D view during a refinement. For each, viser draws for a
quarter of a second and more, at 80 to 150 ms of a core a frame in a browser without a
graphics card, which the search could use."""
GIZMO_HOLD_S = 20.0
"""A gizmo that says nothing for so long is no longer in anybody's hand."""


class Page:
    """The running app: everything between the session and the browsers."""

    def __init__(
        self,
        session: Session,
        controller: Controller,
        access: AccessControl | None = None,
        port: int = 8080,
        shadows: bool = True,
        surroundings: bool = True,
    ) -> None:
        self.session = session
        self.controller = controller
        self.projects = controller.projects
        self._limits = Limits.of_environment()
        self.server = start_viser(access or AccessControl(), port, controller.pictures)
        limit_uploads(self.server, self._limits, self._on_refused)
        self._dark: bool | None = None
        self._viewports: dict[int, Viewport] = {}
        self._view_panels: dict[int, ViewPanel] = {}
        self._claims = CameraClaims()
        self._help = Help()
        self._blinked_at = 0.0
        self._scene_at, self._is_scene_late = -np.inf, False
        self._drag = 0
        self._wake, self._urgent = threading.Event(), threading.Event()
        self._painted_at = -np.inf
        self._is_changed = True
        self._notices: queue.SimpleQueue[Notice] = queue.SimpleQueue()
        self._connecting = threading.Lock()
        self._closed = False
        self.server.scene.configure_default_lights(cast_shadow=shadows)
        if not surroundings:
            self.server.scene.configure_environment_map(hdri=None)
        self.scene = SceneNodes(self.server, self._on_gizmo, self._on_marker)
        self._build()
        session.listen(self._on_change)
        controller.watch(False)
        self.server.on_client_connect(guarded_client(self._on_connect))
        self.server.on_client_disconnect(guarded_client(self._on_disconnect))
        self._paint()
        self._painter = threading.Thread(target=self._paint_on, daemon=True)
        self._painter.start()
        self._paint_soon()

    @property
    def port(self) -> int:
        """The port it listens on."""
        return self.server.get_port()

    def viewport(self, client_id: int) -> Viewport | None:
        """The view of one browser."""
        return self._viewports.get(client_id)

    def close(self) -> None:
        """Stops serving; what browsers have sent by now still counts."""
        hear_out(self.server)
        self._closed = True
        self._paint_soon()
        self._painter.join(timeout=5.0)
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def _build(self) -> None:
        gui = self.server.gui
        gui.set_panel_label("photoreg")
        self._bridge = bridge = Bridge(gui, self._limits)
        bridge.on("stop", lambda *_: self.controller.stop_job())
        bridge.on("exporting", self._on_exporting, on=bool)
        self._status = gui.add_html("")
        self._meter = gui.add_html("")
        self._travel = Tools(gui, bridge, "", (), self._on_travel, head=True)
        tabs = gui.add_tab_group()
        with tabs.add_tab("1 Data"):
            project = ProjectPanel(gui, self.controller)
            data = DataPanel(gui, self.controller, bridge)
        with tabs.add_tab("2 Align") as self._align_tab:
            finding = FindCamerasPanel(gui, self.controller, bridge)
            align = AlignPanel(gui, self.controller, bridge)
        with tabs.add_tab("3 Refine"):
            refine = RefinePanel(gui, self.controller)
        with tabs.add_tab("4 Export"):
            gui.add_html(mounted("sight", act="exporting"))
            export = ExportPanel(gui, self.controller, bridge)
        left = gui.add_panel()
        with left.add_tab("Overlay", viser.Icon.LAYERS_INTERSECT):
            overlay = OverlayPanel(gui, self.controller, bridge)
        with left.add_tab("Points", viser.Icon.TARGET_ARROW):
            points = PointsPanel(gui, self.controller, bridge, self._on_picking)
        self._points = points
        self._panels = (project, data, finding, align, refine, export, overlay, points)
        self._run_panels = (refine, overlay)

        @guarded
        def clicked(event: viser.SceneClickEvent) -> None:
            points.on_surface_click(
                event.client,
                self.scene.frame,
                np.array(event.ray_origin),
                np.array(event.ray_direction),
            )

        # viser's types know of no asynchronous listener; viser itself does.
        self.server.scene.on_click()(cast(Any, clicked))

        gui.add_html(button_hints(gui))
        self._button_commands = ButtonCommands(gui)
        dock(gui, left)
        self._tour = gui.add_html("")
        self._view_order = align.view_order
        self._command("Undo", "cmd/ctrl", self.session.undo)
        self._command("Redo", "cmd/ctrl+shift", self.session.redo)
        # viser's list of keys leaves out punctuation; the page takes any.
        question: Any = "?"
        # On some keyboards it needs Shift, on others none.
        keys = gui.add_command("Keys and mouse", hotkey=question, modifier="shift")
        plain = gui.add_command("Help", hotkey=question)
        whole = gui.add_command("The whole photo (Look through)", hotkey="0")
        frame = gui.add_command("Frame all", hotkey="H")
        cameras = gui.add_command("Show or hide the cameras", hotkey="C")

        @keys.on_trigger
        @plain.on_trigger
        @guarded
        def _(event: viser.CommandEvent) -> None:
            if event.client is not None:
                self._help.toggle(event.client)

        @whole.on_trigger
        @guarded
        def _(event: viser.CommandEvent) -> None:
            viewport = self._viewports.get(event.client_id or 0)
            if viewport is not None:
                viewport.fit()

        @frame.on_trigger
        @guarded
        def _(event: viser.CommandEvent) -> None:
            if event.client is not None:
                self._on_travel(event.client, "frame")

        @cameras.on_trigger
        @guarded
        def _(event: viser.CommandEvent) -> None:
            if event.client is not None:
                self._on_travel(event.client, "cameras")

    def _on_picking(self, browser: int, on: bool) -> None:
        viewport = self._viewports.get(browser)
        if viewport is not None:
            viewport.pick(on)

    def _on_exporting(self, values: Values, client: viser.ClientHandle) -> None:
        viewport = self._viewports.get(client.client_id)
        if viewport is not None:
            viewport.export(values["on"])

    def _on_marker(self, pull: Pull) -> None:
        self._points.on_marker_pull(self.scene.frame, pull)

    def _on_travel(self, client: viser.ClientHandle, value: str) -> None:
        viewport = self._viewports.get(client.client_id)
        if value == "help":
            self._help.toggle(client)
        elif value == "undo":
            self.session.undo()
        elif value == "redo":
            self.session.redo()
        elif viewport is not None and value == "frame":
            viewport.frame_all()
        elif viewport is not None:
            viewport.toggle_cameras()

    def _command(
        self, label: str, modifier: Any, action: Callable[[], str | None]
    ) -> None:
        command = self.server.gui.add_command(label, hotkey="Z", modifier=modifier)

        @command.on_trigger
        @guarded
        def _(event: viser.CommandEvent) -> None:
            name = action()
            if event.client is not None and name is None:
                notify(
                    event.client, label, f"There is nothing to {label.lower()}.", False
                )

    # Painting.

    def _paint_on(self) -> None:
        while True:
            blinks = self.session.state.overlay_style == "blink"
            late = SCENE_PERIOD_S if self._is_scene_late else None
            self._wake.wait(BLINK_PERIOD_S if blinks else late)
            self._urgent.wait(self._painted_at + PASSING_PERIOD_S - time.monotonic())
            self._urgent.clear()
            self._wake.clear()
            if self._closed:
                return
            if blinks and time.monotonic() - self._blinked_at > BLINK_PERIOD_S:
                self._blinked_at = time.monotonic()
                self.session.change(None, blinked)
            try:
                self._paint()
            except Exception as error:  # noqa: BLE001 - the border of a thread: report.
                self._report_to_all("Painting the page", error)
            self._painted_at = time.monotonic()
            threading.Event().wait(PAINT_PERIOD_S)

    def _on_change(self, old: State, new: State) -> None:
        if new.notice is not None and new.notice is not old.notice:
            self._notices.put(new.notice)
        if not is_passing(old, new):
            self._is_changed = True
            self._paint_soon()
        elif new.drawn is not old.drawn or new.notice is not old.notice:
            self._paint_soon()
        else:
            self._wake.set()

    def _paint_soon(self) -> None:
        self._urgent.set()
        self._wake.set()

    def _paint(self) -> None:
        is_changed, self._is_changed = self._is_changed, False
        state = self.session.state
        while not self._notices.empty():
            self._tell_everybody(self._notices.get())
        # What is shown as done is on disk; a write that takes long is said to go on.
        is_kept = self.projects.wait()
        if not is_kept:
            self._paint_soon()
        now, is_running = time.monotonic(), state.run.is_active
        self._is_scene_late = is_running and now - self._scene_at < SCENE_PERIOD_S
        # The others show numbers of the cameras that nobody reads while they fly by.
        is_brief = self._is_scene_late and not is_changed
        with self.server.atomic():
            if state.dark != self._dark:
                self._dark = state.dark
                self._theme(state.dark)
                self.server.scene.set_background_image(backdrop(state.dark))
            put(self._status, "content", status_line(state, is_kept))
            put(self._meter, "content", meter_html(state))
            self._travel.show(travel_tools(state))
            # The truth is known of the demo alone.
            put(self._tour, "content", mounted("tour") if state.document.truth else "")
            for panel in self._run_panels if is_brief else self._panels:
                panel.show(state)
            self._button_commands.show()
            if not self._is_scene_late:
                self._scene_at = now
                self.scene.show(state)
        for number, viewport in list(self._viewports.items()):
            panel = self._view_panels.get(number)
            try:
                viewport.show(state)
                if panel is not None:
                    panel.show(state)
            except RuntimeError as error:
                if not has_left(viewport.client, error):
                    raise

    def _theme(self, dark: bool) -> None:
        self.server.gui.configure_theme(
            dark_mode=dark,
            brand_color=BRAND,
            show_logo=False,
            show_share_button=False,
        )

    # What browsers do.

    def _on_connect(self, client: viser.ClientHandle) -> None:
        viewport = Viewport(
            client, self.controller, self.scene, self._claims, self._paint_soon
        )
        # A tab can be filled by one thread at a time; several may connect at once.
        with self._connecting, self._align_tab:
            panel = ViewPanel(viewport, self.controller, self._bridge, self._view_order)
        self._viewports[client.client_id] = viewport
        self._view_panels[client.client_id] = panel
        self.controller.watch(True)
        self.projects.wait()
        viewport.show(self.session.state)
        panel.show(self.session.state)

    def _on_disconnect(self, client: viser.ClientHandle) -> None:
        self._viewports.pop(client.client_id, None)
        self.controller.watch(bool(self._viewports))
        panel = self._view_panels.pop(client.client_id, None)
        if panel is not None:
            panel.forget()
        self._claims.drop(client.client_id)
        self.controller.intake.left(client.client_id)
        self._help.forget(client)
        self.scene.gizmos.let_go(client.client_id)
        self._paint_soon()

    def _on_refused(self, browser: int, name: str, sentence: str) -> None:
        self._bridge.arrived(name)
        client = self.server.get_clients().get(browser)
        try:
            self.controller.intake.refuse(browser, sentence)
        except PhotoregError as error:
            if client is not None:
                notify(client, "That is not possible", str(error))

    def _on_gizmo(
        self, phase: str, browser: int, change: Callable[[Camera], Camera]
    ) -> None:
        if phase == "start":
            self._drag += 1
        state = self.session.state
        entry, index = state.selected_photo, state.selected
        try:
            if (
                entry is not None
                and state.run.status == "idle"
                and self._claims.take(browser, index, GIZMO_HOLD_S)
            ):
                word = "Move" if state.gizmo == "move" else "Orbit"
                self.session.change(
                    f"{word} camera {index + 1}",
                    with_entry(index, camera=change(entry.camera)),
                    ("gizmo", self._drag),
                )
        finally:
            if phase == "end":
                self._claims.drop(browser)
                self._paint_soon()

    def _report_to_all(self, what: str, error: Exception) -> None:
        log_failure(what, error)
        for client in self.server.get_clients().values():
            report(client, what, error)

    def _tell_everybody(self, notice: Notice) -> None:
        for client in self.server.get_clients().values():
            if is_news(client.client_id, f"{notice.title}: {notice.sentence}"):
                notify(client, notice.title, notice.sentence)


def is_passing(old: State, new: State) -> bool:
    """Whether only a run that goes on has told something new."""
    return (
        new.run.is_active
        and old.run.status == new.run.status
        and all(
            getattr(old, field.name) is getattr(new, field.name)
            for field in dataclasses.fields(State)
            if field.name not in PASSING
        )
    )


def travel_tools(state: State) -> list[Tool]:
    """Undo and redo by name, and the help."""
    idle = state.run.status == "idle"
    undo, redo = state.undo_name, state.redo_name
    return [
        Tool(
            "undo",
            "Undo" if undo is None else f"Undo: {undo}",
            viser.Icon.ARROW_BACK_UP,
            f" {'Undo' if undo is None else f'Undo: {undo}'}",
            undo is not None and idle,
        ),
        Tool(
            "redo",
            "Redo" if redo is None else f"Redo: {redo}",
            viser.Icon.ARROW_FORWARD_UP,
            "" if redo is None else f" Redo: {redo}",
            redo is not None and idle,
        ),
        Tool("frame", "Frame all (H)", viser.Icon.FOCUS_CENTERED),
        Tool("cameras", "Show or hide the cameras (C)", viser.Icon.VIDEO),
        Tool("help", "Help: keys, mouse, tour (?)", viser.Icon.HELP),
    ]


def status_line(state: State, is_kept: bool = True) -> str:
    """What is going on, in one line that is always on screen; what may end it, too."""
    run, job = state.run, state.job
    told: Job | None = None
    if state.saving:
        colour, text = "#e5484d", state.saving
    elif not is_kept:
        colour, text = "#e8a33d", "Keeping your work …"
    elif job is not None:
        left_s = job.seconds_left(time.monotonic())
        left = "" if left_s is None else f" about {in_words(left_s)} left"
        colour, text = "#e8a33d", f"{job.title} …{left}"
        told = job
    elif run.is_active:
        doing = "Paused" if run.status == "paused" else "Refining"
        colour, text = "#e8a33d", f"{doing}: {run.step or 'starting'}"
    elif run.status == "review" and run.grade == "unconvincing":
        colour, text = VERDICTS[run.grade][0], "Unconvincing: tab 3 says what to do."
    elif run.status == "review":
        colour, text = "#2dbeaf", "Refined. Accept or revert in tab 3."
    elif state.document.mesh is None:
        colour = "#98a2b3"
        text = f"{state.note} Drop a scan and your photos on this page.".lstrip()
    elif state.worker:
        colour, text = "#98a2b3", f"{state.worker} …"
    else:
        colour, text = "#2dbeaf", state.note or "Ready."
    content = part("widgets.html", "status", colour=colour, text=text, job=told)
    return mounted("head") + content
