"""The fold of the Refine tab that says what a run may move."""

import dataclasses

import viser

from app.model.markup import escaped
from app.model.session import Session, setting
from app.model.state import HeldPart, State
from app.web.controls import guarded, put, put_value
from photoreg.geometry.lens import Distortion
from photoreg.parameters.gene_box import BoxReach
from photoreg.registration.config import RegistrationConfig

PARTS: dict[HeldPart, tuple[str, str]] = {
    # Longer names would wrap.
    "pose": ("Lock position", "Where this camera stands, and where it looks."),
    "focal": ("Lock zoom", "The focal length: the zoom of this photo."),
    "principal_point": (
        "Lock image centre",
        "The principal point: where in this photo the lens looks straight ahead.",
    ),
    "lens": (
        "Lock lens",
        "The lens distortion of this photo, where the run may change it.",
    ),
}


DISTORTIONS: dict[str, Distortion] = {
    "Keep as it is": "none",
    "Find what shows": "auto",
    "Find k1": "k1",
    "Find k1 and k2": "k1k2",
    "Find all terms": "full",
}
"""What the choice says, and what it means."""
_LABELS = {distortion: label for label, distortion in DISTORTIONS.items()}

_PHOTO = "margin:6px 12px 2px;font-size:14px;font-weight:700;overflow-wrap:anywhere"

BOX_PERCENT = (25, 300, 5)
"""Least, most and step of the box's size, against the preset's."""


def box_percent(state: State) -> int:
    """Size of the box that is set, against the preset's, as the slider shows it."""
    usual = RegistrationConfig.preset(state.preset).box
    least, most, step = BOX_PERCENT
    percent = step * round(100.0 * state.settings.box.focal / usual.focal / step)
    return min(max(percent, least), most)


def reach_words(reach: BoxReach) -> str:
    """How far off a start may be, in pixels of the photos."""
    return (
        f"Looks about {reach.typical_px:.0f} px around the start, and up to "
        f"{reach.farthest_px:.0f} px."
    )


class FreedomPanel:
    """Ticks a photo for what stays exactly as it is."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._gui, self._session = gui, session
        self._names: tuple[str, ...] = ()
        self._nodes: list[viser.GuiHtmlHandle] = []
        self._ticks: dict[tuple[str, HeldPart], viser.GuiCheckboxHandle] = {}
        self._held: set[tuple[str, HeldPart]] = set()
        self._is_one_focal = False
        self._size = gui.add_slider(
            "How far to look, %",
            *BOX_PERCENT,
            100,
            hint="How far from the start to look for the cameras; 100 is the preset's own. "
            "Wider accepts a worse start and needs a longer search.",
        )
        self._reach = gui.add_markdown("")
        self._fold = gui.add_folder("What may move", expand_by_default=False)
        with self._fold:
            gui.add_markdown(
                "All of every camera moves, but for what is ticked here. A camera that "
                "is kept whole still guides the others."
            )
            self._one_focal = gui.add_checkbox(
                "Same zoom for all",
                False,
                hint="The photos were taken with one camera at one zoom: they get one "
                "focal length and one lens distortion.",
            )

            self._distortion = gui.add_dropdown(
                "Lens distortion",
                tuple(DISTORTIONS),
                hint="How much of how the lenses bend lines is found along: more suits "
                "photos straight from a phone or camera, nothing photos that another "
                "program has undistorted.",
            )

        @self._size.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            state = session.state
            usual = RegistrationConfig.preset(state.preset)
            box = usual.box.widened(self._size.value / 100.0)
            config = dataclasses.replace(state.settings, box=box)
            if box_percent(state) != self._size.value:
                session.change(None, setting(config=config))

        @self._distortion.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            chosen, settings = (
                DISTORTIONS[self._distortion.value],
                session.state.settings,
            )
            if chosen != settings.distortion:
                config = dataclasses.replace(settings, distortion=chosen)
                session.change(None, setting(config=config))

        @self._one_focal.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(one_focal=self._one_focal.value))

    def show(self, state: State) -> None:
        """Makes the ticks as ``state`` has them."""
        names = tuple(entry.name for entry in state.document.used)
        if names != self._names:
            self._names = names
            self._rebuild()
        put(self._fold, "visible", state.run.status == "idle" and len(names) > 1)
        is_seen = state.run.status == "idle" and len(names) > 1
        put(self._size, "visible", is_seen)
        put(self._reach, "visible", is_seen)
        put_value(self._size, box_percent(state))
        put_value(self._distortion, _LABELS[state.settings.distortion])
        put(
            self._reach,
            "content",
            "" if state.reach is None else f"*{reach_words(state.reach)}*",
        )
        # Only what has changed: this state may be of before a click, whose tick it
        # would take away again.
        held, before, self._held = set(state.held), self._held, set(state.held)
        for key in (held ^ before) & self._ticks.keys():
            put_value(self._ticks[key], key in held)
        if state.one_focal != self._is_one_focal:
            self._is_one_focal = state.one_focal
            put_value(self._one_focal, state.one_focal)

    def _rebuild(self) -> None:
        for node in (*self._nodes, *self._ticks.values()):
            node.remove()
        self._nodes, self._ticks, self._held = [], {}, set()
        with self._fold:
            for number, name in enumerate(self._names, 1):
                # Markdown would come in a second message, maybe after it is removed again.
                title = f'<div style="{_PHOTO}">{number}. {escaped(name)}</div>'
                self._nodes.append(self._gui.add_html(title))
                for part, (label, help) in PARTS.items():
                    tick = self._gui.add_checkbox(label, False, hint=help)
                    self._ticks[name, part] = tick
                    self._listen(tick, (name, part))

    def _listen(self, tick: viser.GuiCheckboxHandle, key: tuple[str, HeldPart]) -> None:
        @tick.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            held = [other for other in self._session.state.held if other != key]
            if tick.value:
                held.append(key)
            self._session.change(None, setting(held=tuple(held)))
