"""Tab 1, Data: the mesh, the photos, the cameras' file."""

import math

import viser

from app.control.controller import Controller
from app.model import photo_list
from app.model.camera_moves import guessed_focal_px
from app.model.markup import escaped, sending
from app.model.point_pairs import index_of_photo
from app.model.session import select, setting, with_document
from app.model.state import PhotoEntry, State, Unit, UpAxis
from app.model.up_axis import guessed_up, with_up_axis
from app.scene.own_colours import has_own_colours
from app.web.bridge import Bridge, Values, Whole
from app.web.controls import guarded, guarded_slow, put, put_value
from app.web.uploads import too_large
from app.web.widgets import SMALL_BUTTON, Choice, Option, help_line
from photoreg.formats.cameras.registry import CAMERA_SUFFIXES
from photoreg.formats.meshes.read import MESH_SUFFIXES
from photoreg.formats.photos.registry import formats_in_words
from photoreg.geometry.mesh import Mesh
from photoreg.limits import Limits
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
    f'Something wrong with the view? <button style="{SMALL_BUTTON}" data-diagnose title="'
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
        cards = "".join(
            self._card(i, entry, state, busy) for i, entry in enumerate(state.photos)
        )
        put(self._photo_cards, "content", f'<div style="{_COLUMN}">{cards}</div>')

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

    def _card(self, index: int, entry: PhotoEntry, state: State, busy: bool) -> str:
        # By its address: the cards are sent anew with every step of a run.
        picture = self._controller.pictures.address(entry.photo, "thumbnail")
        name = escaped(entry.name)
        edge = "#2dbeaf" if index == state.selected else "transparent"
        faded = "" if entry.enabled else "opacity:.5;"
        facts = [f"{entry.photo.width} × {entry.photo.height} px"]
        if entry.pairs:
            facts.append(f"{len(entry.pairs)} points")
        if entry.mask_png is not None:
            facts.append("mask")
        last = index == len(state.photos) - 1
        at_name = (
            f'<button title="Rename {name}" aria-label="Rename {name}" '
            f'style="{_SMALL}{_DIM if busy else ""}" {"disabled" if busy else ""} '
            "data-rename>✎</button>"
            + _button("✕", f"Remove {name}", busy, "remove", entry)
        )
        buttons = (
            _button("▲", f"Move {name} up", busy or index == 0, "shift", entry, by=-1)
            + _button("▼", f"Move {name} down", busy or last, "shift", entry, by=1)
            + _button(
                "In use" if entry.enabled else "Not in use",
                f"{'Leave out' if entry.enabled else 'Use'} {name}",
                busy,
                "enable",
                entry,
                on=not entry.enabled,
            )
            + _button(
                f"{'☑' if entry.is_cropped else '☐'} Cropped",
                f"Take {name} for {'the whole photo' if entry.is_cropped else 'a part of one'}",
                busy,
                "crop",
                entry,
                on=not entry.is_cropped,
            )
        )
        return (
            f'<div data-photo="{name}" '
            f'style="{_CARD}cursor:pointer;border-left:3px solid {edge}" '
            f"{sending('select', photo=entry.name)}>"
            # A click anywhere on the card is one on the picture, its only button for this.
            f'<button title="Work on {name}" aria-label="Photo {name}" '
            f'aria-pressed="{str(index == state.selected).lower()}" style="{_PICTURE}">'
            f'<img src="{picture}" alt="" style="width:64px;height:56px;display:block;'
            f'object-fit:cover;border-radius:4px;{faded}"></button>'
            f'<div style="min-width:0;flex:1"><div style="display:flex;gap:3px">'
            f'<div style="{_NAME};flex:1;min-width:0;{faded}" '
            f'class="pr-name" title="{name}">{index + 1}. {escaped(entry.name)}'
            f'</div>{at_name}</div><div style="{_FACTS};line-height:1.35">{" · ".join(facts)}<br>'
            f"{escaped(focal_text(entry))}</div>"
            f'<div style="display:flex;gap:3px;margin-top:4px">{buttons}</div>'
            "</div></div>"
        )


def focal_text(entry: PhotoEntry) -> str:
    """The focal length and, while it is as it was loaded, where it came from."""
    focal_px, photo = entry.camera.focal_px, entry.photo
    text = f"f {focal_px:.0f} px"
    if photo.exif_focal_px is not None:
        at_start, where = photo.exif_focal_px, photo.exif_focal_note or "by EXIF"
    else:
        at_start, where = guessed_focal_px(photo), "a guess: no EXIF"
    text = f"{text}, {where}" if math.isclose(focal_px, at_start) else text
    if photo.known_lens is not None and entry.camera.lens == photo.known_lens:
        text += f" · lens {photo.known_lens_note}"
    if entry.is_cropped:
        text += " · cropped: its middle may not be the lens's; give the whole photo if you can"
    return text


def _button(
    text: str, title: str, disabled: bool, act: str, entry: PhotoEntry, **values: object
) -> str:
    return (
        f'<button title="{title}" aria-label="{title}" style="{_SMALL}'
        f'{_DIM if disabled else ""}" '
        f"{'disabled' if disabled else ''} "
        f"{sending(act, photo=entry.name, **values)}>{text}</button>"
    )


_SMALL = (
    "font:inherit;font-size:11px;color:inherit;background:rgba(128,140,155,.2);"
    "border:0;border-radius:4px;padding:1px 6px;cursor:pointer;line-height:1.5;"
    "white-space:nowrap;flex:none"
)
_DIM = ";opacity:.35;cursor:default"
_COLUMN = "display:flex;flex-direction:column;gap:6px;margin:2px 12px 4px"
_CARD = (
    "display:flex;gap:10px;align-items:center;padding:6px 8px;border-radius:6px;"
    "background:rgba(128,140,155,.14);"
)
_PICTURE = "border:0;padding:0;background:none;border-radius:4px;cursor:pointer"
_EMPTY = (
    "border:2px dashed #2dbeaf;border-radius:10px;padding:22px 12px;text-align:center;"
    "font-size:13px;line-height:1.6"
)
_NAME = (
    "font-size:13px;font-weight:600;white-space:nowrap;overflow:hidden;"
    "text-overflow:ellipsis"
)
_FACTS = "font-size:12px;opacity:.7"


def _opening_html(state: State, busy: bool, limits: Limits) -> str:
    """The button that opens files; while one is read, which."""
    job = state.job
    text = "Open files …" if job is None else f"{escaped(job.title)} …"
    no_photos = busy or not state.document.photos
    return (
        '<div style="margin:4px 12px 10px">'
        + _big_button(
            text,
            "A mesh, photos, or both, from this computer",
            "background:#26a69a;color:#04211e",
            busy,
        )
        + f'<div style="{_FINE_PRINT};margin-bottom:9px">'
        "Or drop them anywhere on this page, several at once. Mesh: "
        f"{', '.join(suffix[1:].upper() for suffix in MESH_SUFFIXES)}. "
        f"Photos: {formats_in_words()}. Up to {limits.file_mb:,.0f} MB each. A new "
        "photo gets a first camera in front of the object; place it in the next tab.</div>"
        + _big_button(
            "Load cameras …",
            "Puts the cameras where another program's file says",
            "background:rgba(128,140,155,.25);color:inherit",
            no_photos,
            ",".join(CAMERA_SUFFIXES) + ",.zip",
        )
        + f'<div style="{_FINE_PRINT}">'
        "To go on from another program: COLMAP (cameras and images together, or a zip), "
        "Metashape’s XML, RealityScan’s .xmp, Meshroom’s .sfm, MeshLab .mlp, nerfstudio, "
        "texrecon, OpenCV, Bundler, or photoreg’s own cameras.json. Matched to the photos by file name.</div></div>"
    )


_FINE_PRINT = "font-size:12.5px;opacity:.75;margin-top:7px;line-height:1.45"


def _big_button(
    text: str, title: str, colours: str, disabled: bool, accept: str = ""
) -> str:
    dim = "opacity:.5;cursor:default" if disabled else "cursor:pointer"
    return (
        f'<button title="{title}" {"disabled" if disabled else ""} '
        'style="font:inherit;font-size:14px;'
        f"font-weight:600;border:0;border-radius:5px;padding:9px;width:100%;{colours};"
        f'{dim}" data-choose="{accept}">{text}</button>'
    )


def _mesh_card(state: State) -> str:
    mesh = state.document.mesh
    if mesh is None:
        return (
            f'<div style="{_COLUMN}"><div style="{_EMPTY}">'
            '<b style="font-size:15px">Drop a scan and your photos here</b><br>'
            "or anywhere on this page, all at once.</div></div>"
        )
    size = mesh.bounds[1] - mesh.bounds[0]
    name = escaped(mesh.name)
    sides = " × ".join(number(float(side)) for side in size)
    unit = state.document.unit
    facts = f"{len(mesh.faces):,} triangles · {sides}{' ' if unit else ''}{unit}"
    return (
        f'<div style="{_COLUMN}"><div style="{_CARD}"><div style="min-width:0">'
        f'<div style="{_NAME}">{name}</div>'
        f'<div style="{_FACTS}">{facts}</div></div></div></div>'
    )


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
