"""Tab 1, Data: the mesh, the photos, the cameras' file."""

import base64
import html

import cv2
import viser

from app.bus import Bus
from app.conductor import Conductor
from app.controls import confirm, guarded, guarded_slow, put, put_value
from app.session import select, setting, with_entry, with_photo_removed
from app.state import PhotoEntry, State

THUMBNAIL_PX = 160


class DataPanel:
    """Controls of the Data tab."""

    def __init__(self, gui: viser.GuiApi, conductor: Conductor, bus: Bus) -> None:
        self._thumbnails: dict[int, tuple[object, str]] = {}
        self._card_key: object = None
        session = conductor.session
        gui.add_markdown("A scanned surface, and the photos to lay onto it.")
        self._mesh_card = gui.add_html("")
        self._photo_cards = gui.add_html("")
        self._open = gui.add_html("")
        with gui.add_folder(
            "Selected photo", expand_by_default=False
        ) as self._selected:
            self._choice = gui.add_dropdown("Photo", photo_options(session.state))
            self._enabled = gui.add_checkbox(
                "In use", True, hint="Refinement and texture leave out the others."
            )
            self._remove = gui.add_button(
                "Remove this photo", icon=viser.Icon.TRASH, color="gray"
            )
        with gui.add_folder("Demo and page", expand_by_default=False):
            self._demo = gui.add_button("Open the demo", icon=viser.Icon.SPARKLES)
            self._dark = gui.add_checkbox("Dark page", True)

        bus.on(
            "batch",
            lambda values, client: conductor.intake.expect(
                client.client_id, int(values["files"])
            ),
        )

        @bus.upload.on_upload
        @guarded
        def _(event: viser.GuiEvent) -> None:
            # On the loop, in the order of arrival: the next file takes its place.
            file = event.target.value
            bus.arrived(file.name)
            conductor.intake.receive(event.client_id or 0, file.name, file.content)

        @self._demo.on_click
        @guarded_slow
        def _(_: viser.GuiEvent) -> None:
            conductor.open_demo()

        @self._choice.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, select(index_of(session.state, self._choice.value)))

        @self._enabled.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            index = session.state.selected
            name = "Use photo" if self._enabled.value else "Leave out photo"
            session.change(
                f"{name} {index + 1}", with_entry(index, enabled=self._enabled.value)
            )

        @self._remove.on_click
        @guarded
        def _(event: viser.GuiEvent) -> None:
            entry, index = session.state.selected_photo, session.state.selected
            if entry is None or event.client is None:
                return
            confirm(
                event.client,
                "Remove this photo?",
                f"**{entry.name}** and its camera leave the scene. The file on disk "
                "stays, and Undo brings it back.",
                "Remove",
                lambda: (
                    session.change(f"Remove {entry.name}", with_photo_removed(index)),
                    None,
                )[1],
            )

        @self._dark.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(dark=self._dark.value))

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        busy = state.run.status != "idle" or state.job is not None
        put(self._open, "content", _opening_html(state, busy))
        for control in (self._demo, self._remove):
            put(control, "disabled", busy)
        put(self._selected, "visible", bool(state.document.photos))
        put_value(self._dark, state.dark)
        options = photo_options(state)
        put(self._choice, "options", options)
        if state.selected_photo is not None:
            put_value(self._choice, options[state.selected])
            put_value(self._enabled, state.selected_photo.enabled)
        key = (
            state.document.mesh,
            state.selected,
            tuple(
                (e.photo, e.enabled, round(e.camera.focal_px, 1)) for e in state.photos
            ),
        )
        if _same(key, self._card_key):
            return
        self._card_key = key
        put(self._mesh_card, "content", _mesh_card(state))
        cards = "".join(
            self._card(i, entry, i == state.selected)
            for i, entry in enumerate(state.photos)
        )
        put(self._photo_cards, "content", f'<div style="{_COLUMN}">{cards}</div>')

    def _card(self, index: int, entry: PhotoEntry, selected: bool) -> str:
        known = self._thumbnails.get(index)
        if known is None or known[0] is not entry.photo:
            known = (entry.photo, _thumbnail(entry))
            self._thumbnails[index] = known
        edge = "#2dbeaf" if selected else "transparent"
        faded = "" if entry.enabled else "opacity:.45;"
        use = "" if entry.enabled else " · not in use"
        return (
            f'<div style="{_CARD}{faded}border-left:3px solid {edge}">'
            f'<img src="{known[1]}" style="width:64px;height:48px;object-fit:cover;'
            'border-radius:4px">'
            f'<div style="min-width:0"><div style="{_NAME}">{index + 1}. '
            f'{html.escape(entry.name)}</div><div style="{_FACTS}">'
            f"{entry.photo.width} × {entry.photo.height} px · "
            f"f {entry.camera.focal_px:.0f} px{use}</div></div></div>"
        )


_COLUMN = "display:flex;flex-direction:column;gap:6px;margin:2px 12px 4px"
_CARD = (
    "display:flex;gap:10px;align-items:center;padding:6px 8px;border-radius:6px;"
    "background:rgba(128,140,155,.14);"
)
_NAME = (
    "font-size:13px;font-weight:600;white-space:nowrap;overflow:hidden;"
    "text-overflow:ellipsis"
)
_FACTS = "font-size:12px;opacity:.7"


def _opening_html(state: State, busy: bool) -> str:
    """The button that opens files; while one is read, which."""
    job = state.job
    text = "Open files …" if job is None else f"{html.escape(job.title)} …"
    dim = "opacity:.5;cursor:default" if busy else "cursor:pointer"
    return (
        f'<div style="margin:4px 12px 10px"><button {"disabled" if busy else ""} style="'
        "font:inherit;font-size:14px;font-weight:600;border:0;border-radius:5px;"
        f'padding:9px;width:100%;background:#26a69a;color:#04211e;{dim}" '
        f'onclick="photoreg.choose()">{text}</button>'
        '<div style="font-size:12.5px;opacity:.75;margin-top:7px;line-height:1.45">'
        "Or drop them anywhere on this page, several at once. Mesh: OBJ, PLY, STL, GLB, "
        "OFF. Photos: JPEG, PNG, TIFF. Cameras: JSON. A new photo gets a first camera "
        "in front of the object; place it in the next tab.</div></div>"
    )


def _mesh_card(state: State) -> str:
    mesh = state.document.mesh
    if mesh is None:
        name, facts = "No mesh yet", "Open one to begin."
    else:
        size = mesh.bounds[1] - mesh.bounds[0]
        name = html.escape(mesh.name)
        facts = f"{len(mesh.faces):,} triangles · " + " × ".join(
            f"{side:.3g}" for side in size
        )
    return (
        f'<div style="{_COLUMN}"><div style="{_CARD}"><div style="min-width:0">'
        f'<div style="{_NAME}">{name}</div>'
        f'<div style="{_FACTS}">{facts}</div></div></div></div>'
    )


def _thumbnail(entry: PhotoEntry) -> str:
    small = entry.photo.resized(THUMBNAIL_PX).pixels
    _, data = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR))
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


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
