"""Tab 1, Data: the mesh, the photos, the cameras' file."""

import math

import viser

from app.control.controller import Controller
from app.model import photo_list
from app.model.camera_moves import guessed_focal_px
from app.model.point_pairs import index_of_photo
from app.model.session import select, setting, with_document
from app.model.state import PhotoEntry, State, Unit, UpAxis
from app.model.up_axis import guessed_up, with_up_axis
from app.scene.own_colours import has_own_colours
from app.web.bridge import Bridge, Values, Whole
from app.web.controls import guarded, guarded_slow, put, put_value
from app.web.uploads import too_large
from app.web.widgets import Choice, Option, help_line
from photoreg.formats.cameras.registry import CAMERA_SUFFIXES
from photoreg.formats.meshes.read import MESH_SUFFIXES
from photoreg.formats.photos.registry import formats_in_words
from photoreg.geometry.mesh import Mesh
from photoreg.limits import Limits
from photoreg.report.templates import part
from photoreg.words import number

UP_AXES: dict[UpAxis, Option] = {
    "auto": Option("Auto", "Guessed from the mesh and its cameras."),
    "y": Option("Y", "The model's y axis points upwards."),
    "z": Option("Z", "The model's z axis points upwards, as in surveys and CAD."),
}
UNITS: dict[Unit, Option] = {
    "": Option("None", "Lengths are told as bare numbers. Choose the scan's unit."),
    "mm": Option(
        "mm", "The scan is in millimetres. Lengths say so; nothing is scaled."
    ),
    "cm": Option(
        "cm", "The scan is in centimetres. Lengths say so; nothing is scaled."
    ),
    "m": Option("m", "The scan is in metres. Lengths say so; nothing is scaled."),
}

DIAGNOSTICS_HTML = help_line(
    'Something wrong with the view? <button class="pr-small" data-diagnose title="'
    'Connection, speed of drawing and nodes of the scene">Diagnostics</button>'
)


def _unit(value: str) -> Unit:
    return next(unit for unit in UNITS if unit == value)


def _axis(value: str) -> UpAxis:
    return next(axis for axis in UP_AXES if axis == value)


class DataPanel:
    """Controls of the Data tab."""

    def __init__(
        self, gui: viser.GuiApi, controller: Controller, bridge: Bridge
    ) -> None:
        self._card_key: object = None
        self._guessed: tuple[Mesh, tuple[tuple[float, float, float], str]] | None = None
        self._session = session = controller.session
        self._controller = controller
        self._limits = bridge.limits
        gui.add_markdown("A scanned surface, and the photos to lay onto it.")
        self._mesh_card = gui.add_html("")
        self._unit = Choice(
            gui,
            bridge,
            "Unit",
            UNITS,
            lambda _, value: session.change("Unit", with_document(unit=_unit(value))),
        )
        self._up = Choice(
            gui,
            bridge,
            "Up axis",
            UP_AXES,
            lambda _, value: session.change(
                "Up axis", lambda state: with_up_axis(state, _axis(value))
            ),
        )
        self._own_colours = gui.add_checkbox(
            "Own colours",
            True,
            visible=False,
            hint="The model wears the colours that the scan came with, or none.",
        )
        self._photo_cards = gui.add_html("")
        self._open = gui.add_html("")
        with gui.add_folder("Demo and page", expand_by_default=False):
            self._demo = gui.add_button("Open the demo", icon=viser.Icon.SPARKLES)
            gui.add_html(
                help_line("A shell and two photos of it, to try all this with.")
            )
            self._dark = gui.add_checkbox(
                "Dark page", True, hint="Dark or light colours, in every window."
            )
            gui.add_html(DIAGNOSTICS_HTML)

        bridge.on("select", lambda values, _: self._select(values["photo"]), photo=str)
        bridge.on("rename", self._on_rename, photo=str, name=str)
        bridge.on("enable", self._on_enable, photo=str, on=bool)
        bridge.on("crop", self._on_crop, photo=str, on=bool)
        bridge.on("shift", self._on_shift, photo=str, by=Whole)
        bridge.on("remove", self._on_remove, photo=str)
        bridge.on(
            "batch",
            lambda values, client: controller.intake.expect(
                client.client_id, values["files"]
            ),
            files=Whole,
        )
        bridge.on("oversized", self._on_oversized, name=str, size=Whole)

        @bridge.upload.on_upload
        @guarded
        def _(event: viser.GuiEvent) -> None:
            # On the loop, in the order of arrival: the next file takes its place.
            file = event.target.value
            bridge.arrived(file.name)
            controller.intake.receive(event.client_id or 0, file.name, file.content)

        @self._demo.on_click
        @guarded_slow
        def _(_: viser.GuiEvent) -> None:
            controller.open_demo()

        @self._own_colours.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(show_own_colours=self._own_colours.value))

        @self._dark.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(dark=self._dark.value))

    def _on_oversized(self, values: Values, client: viser.ClientHandle) -> None:
        """The page holds a file back that is too large."""
        sentence = too_large(values["name"], values["size"], self._limits)
        self._controller.intake.refuse(client.client_id, sentence)

    # What is done in the cards.

    def _select(self, name: str) -> None:
        index = index_of_photo(self._session.state, name)
        self._session.change(None, select(index))

    def _on_rename(self, values: Values, _: viser.ClientHandle) -> None:
        old, new = values["photo"], values["name"]
        self._session.change(f"Rename {old}", photo_list.renamed(old, new))

    def _on_enable(self, values: Values, _: viser.ClientHandle) -> None:
        name, on = values["photo"], values["on"]
        step = f"{'Use' if on else 'Leave out'} {name}"
        self._session.change(step, photo_list.enabled(name, on))

    def _on_crop(self, values: Values, _: viser.ClientHandle) -> None:
        name, on = values["photo"], values["on"]
        step = f"Take {name} for {'cropped' if on else 'whole'}"
        self._session.change(step, photo_list.cropped(name, on))

    def _on_shift(self, values: Values, _: viser.ClientHandle) -> None:
        name, by = values["photo"], values["by"]
        self._session.change(f"Move {name} in the list", photo_list.shifted(name, by))

    def _on_remove(self, values: Values, _: viser.ClientHandle) -> None:
        name = values["photo"]
        self._session.change(f"Remove {name}", photo_list.removed(name))

    # What is shown.

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        busy = state.run.status != "idle" or state.job is not None
        put(self._open, "content", _opening_html(state, busy, self._limits))
        put(self._demo, "disabled", busy)
        put_value(self._dark, state.dark)
        mesh = state.document.mesh
        has_own = mesh is not None and has_own_colours(mesh)
        put(self._own_colours, "visible", has_own)
        put_value(self._own_colours, state.show_own_colours)
        key = (
            state.document.mesh,
            state.document.up,
            state.document.up_axis,
            state.document.unit,
            state.selected,
            busy,
            tuple(
                (
                    e.photo,
                    e.enabled,
                    e.cropped,
                    e.mask_png,
                    len(e.pairs),
                    focal_text(e),
                )
                for e in state.photos
            ),
        )
        if _same(key, self._card_key):
            return
        self._card_key = key
        put(self._mesh_card, "content", _mesh_card(state))
        self._unit.show(state.document.unit, visible=mesh is not None)
        self._show_up(state)
        cards = [self._card(i, entry, state) for i, entry in enumerate(state.photos)]
        content = part("data.html", "photos", cards=cards, busy=busy)
        put(self._photo_cards, "content", content)

    def _show_up(self, state: State) -> None:
        document = state.document
        options, mesh = dict(UP_AXES), document.display_mesh
        if mesh is not None and document.up_axis == "auto":
            # Once a mesh: the cards are made anew with every step of a dragged slider.
            if self._guessed is None or self._guessed[0] is not mesh:
                self._guessed = mesh, guessed_up(mesh)
            up, reason = self._guessed[1]
            if document.up != up:
                reason = "As the cameras stand."
            options["auto"] = options["auto"]._replace(help=reason)
        self._up.show(
            document.up_axis, visible=document.mesh is not None, options=options
        )

    def _card(self, index: int, entry: PhotoEntry, state: State) -> dict[str, object]:
        facts = [f"{entry.photo.width} × {entry.photo.height} px"]
        if entry.pairs:
            facts.append(f"{len(entry.pairs)} points")
        if entry.mask_png is not None:
            facts.append("mask")
        return {
            "entry": entry,
            "selected": index == state.selected,
            # By its address: the cards are sent anew with every step of a run.
            "picture": self._controller.pictures.address(entry.photo, "thumbnail"),
            "facts": facts,
            "focal": focal_text(entry),
        }


def focal_text(entry: PhotoEntry) -> str:
    """The focal length and, while it is as it was loaded, where it came from."""
    focal_px, photo = entry.camera.focal_px, entry.photo
    text = f"f {focal_px:.0f} px"
    if photo.exif_focal_px is not None:
        at_start, where = photo.exif_focal_px, photo.exif_focal_note or "by EXIF"
    else:
        at_start, where = guessed_focal_px(photo), "a guess: no EXIF"
    text = f"{text}, {where}" if math.isclose(focal_px, at_start) else text
    known = photo.known_lens
    if known is not None and entry.camera.lens == known.lens:
        text += f" · lens by lensfun ({known.name})"
    if entry.is_cropped:
        text += " · cropped: its middle may not be the lens's; give the whole photo if you can"
    return text


def _opening_html(state: State, busy: bool, limits: Limits) -> str:
    """The button that opens files; while one is read, which."""
    return part(
        "data.html",
        "opening",
        title="Open files" if state.job is None else state.job.title,
        busy=busy,
        no_photos=busy or not state.document.photos,
        meshes=", ".join(suffix[1:].upper() for suffix in MESH_SUFFIXES),
        photos=formats_in_words(),
        file_mb=limits.file_mb,
        camera_suffixes=",".join((*CAMERA_SUFFIXES, ".zip")),
    )


def _mesh_card(state: State) -> str:
    mesh = state.document.mesh
    if mesh is None:
        return part("data.html", "mesh", name=None, facts="")
    size = mesh.bounds[1] - mesh.bounds[0]
    sides = " × ".join(number(float(side)) for side in size)
    unit = state.document.unit
    facts = f"{len(mesh.faces):,} triangles · {sides}{' ' if unit else ''}{unit}"
    return part("data.html", "mesh", name=mesh.name, facts=facts)


def _same(a: object, b: object) -> bool:
    return b is not None and a == b


def photo_options(state: State) -> tuple[str, ...]:
    """The photos as a dropdown names them."""
    names = tuple(f"{i + 1}. {e.name}" for i, e in enumerate(state.document.photos))
    return names or ("none",)


def index_of(state: State, option: str) -> int:
    """The index of a photo that a dropdown names."""
    options = photo_options(state)
    return options.index(option) if option in options else 0
