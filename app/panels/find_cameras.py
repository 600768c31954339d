"""In Align: the button that finds the cameras, and the poses to pick from."""

import base64
import functools

import viser

from app.control.controller import Controller
from app.model.markup import escaped, opening
from app.model.state import FoundCamera, State
from app.web.bridge import Bridge
from app.web.controls import guarded, put
from app.web.widgets import Choice, Option, help_line
from photoreg.geometry.camera import same_camera

HELP = (
    "By the object's outline before a plain background, in a mask or a box; elsewhere by "
    "what several photos show alike. Cameras that somebody has placed stay."
)
BOX_HTML = help_line(
    'Much behind the object? <button title="Opens the photo at the left, to drag the box" '
    f'class="pr-small" {opening("Points", "box")}>Draw a box around it</button>'
)


class FindCamerasPanel:
    """Controls that find cameras without a click."""

    def __init__(
        self, gui: viser.GuiApi, controller: Controller, bridge: Bridge
    ) -> None:
        self._controller = controller
        self._all = gui.add_button(
            "Find the cameras", icon=viser.Icon.CAMERA_SEARCH, hint=HELP
        )
        self._one = gui.add_button(
            "Find this camera",
            icon=viser.Icon.CAMERA_SEARCH,
            color="gray",
            hint="The same for this photo alone, wherever its camera stands now.",
        )
        gui.add_html(BOX_HTML)
        self._told = gui.add_html("")
        self._poses = Choice(
            gui, bridge, "Pose", {}, lambda _, value: self._pick(value)
        )
        self._shown: FoundCamera | None = None

        @self._all.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            controller.finder.find()

        @self._one.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            controller.finder.find(only_selected=True)

    def _pick(self, value: str) -> None:
        if self._shown is not None:
            self._controller.finder.pick(self._shown.photo, int(value))

    def show(self, state: State) -> None:
        """Shows what was found of the selected photo, where that is unsure."""
        entry = state.selected_photo
        is_busy = state.job is not None or state.run.status != "idle"
        is_possible = state.document.mesh is not None and bool(state.document.used)
        put(self._all, "disabled", is_busy or not is_possible)
        put(self._one, "disabled", is_busy or not is_possible)
        self._shown = next(
            (
                one
                for one in state.found
                if entry is not None
                and one.photo == entry.name
                and one.grade != "found"
            ),
            None,
        )
        shown = self._shown
        put(self._told, "content", "" if shown is None else _told_html(shown))
        poses = () if shown is None else shown.candidates
        options = {
            str(k): Option(f"Pose {k + 1}", title=f"Put the camera into pose {k + 1}")
            for k in range(len(poses))
        }
        taken = (
            k
            for k, pose in enumerate(poses)
            if entry is not None and same_camera(entry.camera, pose)
        )
        self._poses.show(str(next(taken, "")), visible=bool(poses), options=options)


@functools.lru_cache(maxsize=8)
def _told_html(found: FoundCamera) -> str:
    """What is known of a photo, and its poses as pictures."""
    pictures = "".join(
        f'<img alt="Pose {k + 1}" title="Pose {k + 1}" style="flex:1;min-width:0;'
        'max-width:50%;border-radius:4px" src="data:image/jpeg;base64,'
        f'{base64.b64encode(jpeg).decode()}">'
        for k, jpeg in enumerate(found.pictures)
    )
    return (
        help_line(escaped(found.sentence))
        + f'<div style="display:flex;gap:4px;margin:0 12px 8px">{pictures}</div>'
    )
