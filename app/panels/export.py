"""Tab 4, Export: the textured model and the cameras."""

import base64
import dataclasses
from collections.abc import Callable
from typing import Any

import viser

from app.control.controller import Controller
from app.model.markup import escaped, in_markdown
from app.model.session import setting
from app.model.state import State, Texture
from app.scene.own_colours import has_own_colours
from app.web.bridge import Bridge
from app.web.controls import guarded, guarded_slow, notify, put, put_value
from app.web.widgets import Choice, Option, help_line
from photoreg.errors import InputError
from photoreg.formats.cameras.registry import WRITTEN_FORMATS
from photoreg.words import in_words

SIZES = {
    "auto": Option("Auto", "Somewhat finer than the photos' pixels on the surface."),
    "1024": Option("1024", "Small, for the web; 1024 texels on the longer side."),
    "2048": Option("2048", "Good for most uses; 2048 texels on the longer side."),
    "4096": Option("4096", "Fine; 4096 texels on the longer side."),
    "8192": Option("8192", "The finest; some older devices cannot show it."),
}
MODES = {
    "blend": Option("Blend", "Photos pass into each other, so that no seam shows."),
    "best": Option("Best view", "Each spot from its best photo alone; seams may show."),
}
LAYOUTS = {
    "own": Option(
        "Scan's UV layout", "The layout that the model came with, kept as it is."
    ),
    "new": Option("New", "The surface is cut into charts and laid out afresh."),
}
PICTURES = {
    "png": Option("PNG", "The picture exactly as it was made."),
    "jpeg": Option("JPEG", "Several times smaller, at hardly any loss."),
}
FORMATS = {
    "obj": Option("OBJ", "OBJ, MTL and picture in a zip, for any 3-D program."),
    "glb": Option("GLB", "One file with all in it, for the web and for viewers."),
    "usdz": Option("USDZ", "One file with all in it, for Apple’s devices."),
    "ply": Option("PLY", "PLY with its picture in a zip, for MeshLab."),
    "coloured ply": Option("PLY, no picture", "Colours at the vertices, no texture."),
}

PROGRAMS = {format.label: name for name, format in WRITTEN_FORMATS.items()}


class ExportPanel:
    """Controls of the Export tab."""

    def __init__(
        self, gui: viser.GuiApi, controller: Controller, bridge: Bridge
    ) -> None:
        session = controller.session

        def configure(field: str, read: Callable[[str], Any] = str) -> Callable:
            def heard(_: viser.ClientHandle, value: str) -> None:
                config = session.state.texture_config
                config = dataclasses.replace(config, **{field: read(value)})
                session.change(None, setting(texture_config=config))

            return heard

        def choose(field: str) -> Callable:
            def heard(_: viser.ClientHandle, value: str) -> None:
                choice = dataclasses.replace(
                    session.state.model_choice, **{field: value}
                )
                session.change(None, setting(model_choice=choice))

            return heard

        def choose_cameras(**values: Any) -> None:
            choice = dataclasses.replace(session.state.cameras_choice, **values)
            session.change(None, setting(cameras_choice=choice))

        gui.add_markdown("The photos as one texture on the mesh.")
        self._size = Choice(gui, bridge, "Size", SIZES, configure("size", _size))
        self._mode = Choice(gui, bridge, "Photos", MODES, configure("mode"))
        self._layout = Choice(
            gui, bridge, "Layout", LAYOUTS, configure("keep_uv", "own".__eq__)
        )
        self._unseen = Choice(gui, bridge, "Unseen", {}, configure("unseen"))
        self._colour = gui.add_rgb(
            "Colour",
            (128, 128, 128),
            visible=False,
            hint="Of the surface that no photo saw.",
        )
        self._bake = gui.add_button(
            "Make the texture",
            icon=viser.Icon.BRUSH,
            hint="Lays the photos onto the mesh with the cameras as they are now.",
        )
        self._text = gui.add_markdown("")
        self._show = gui.add_checkbox(
            "Show it",
            True,
            visible=False,
            hint="The textured model in the 3-D view, or the bare mesh.",
        )
        with gui.add_folder(
            "Which photo paints where", expand_by_default=False, visible=False
        ) as self._coverage_folder:
            self._coverage = gui.add_html("")
        self._format = Choice(gui, bridge, "File", FORMATS, choose("format"))
        self._picture = Choice(gui, bridge, "Picture", PICTURES, choose("picture"))
        self._model = gui.add_button(
            "Download the model",
            icon=viser.Icon.DOWNLOAD,
            disabled=True,
            hint="The mesh with the texture made last, in the file format above.",
        )
        gui.add_divider()
        gui.add_markdown("The cameras, for your other programs.")
        self._program = gui.add_dropdown(
            "For", tuple(PROGRAMS), hint="The program that shall read the cameras."
        )
        self._loses = gui.add_html("")
        self._with_photos = gui.add_checkbox(
            "With the photos",
            True,
            hint="Puts the photo files into the zip, where the program looks for them.",
        )
        self._undistorted = gui.add_checkbox(
            "Undistorted",
            False,
            hint="For programs that know no lens distortion: photos as ideal lenses would "
            "have taken them, as PNG, and their cameras without lenses.",
        )
        self._cameras = gui.add_button(
            "Download the cameras",
            icon=viser.Icon.CAMERA,
            color="gray",
            hint="All cameras as they are now, in that program's format.",
        )

        @self._program.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            choose_cameras(format=PROGRAMS[self._program.value])

        @self._with_photos.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            choose_cameras(with_photos=self._with_photos.value)

        @self._undistorted.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            choose_cameras(undistorted=self._undistorted.value)

        @self._cameras.on_click
        @guarded_slow
        def _(event: viser.GuiEvent) -> None:
            deliver = _sending_to(event.client)
            made = controller.pack_cameras()
            deliver(made.name, made.content)
            if made.losses and event.client is not None:
                text = "It loses something: " + " ".join(made.losses)
                notify(event.client, made.name, text, bad=False)

        @self._colour.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            config = dataclasses.replace(
                session.state.texture_config, unseen_colour=self._colour.value
            )
            session.change(None, setting(texture_config=config))

        @self._bake.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            controller.bake()

        @self._show.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(show_texture=self._show.value))

        @self._model.on_click
        @guarded
        def _(event: viser.GuiEvent) -> None:
            controller.pack_model(_sending_to(event.client))

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        job, config, choice = state.job, state.texture_config, state.model_choice
        idle = state.run.status == "idle" and job is None
        usable = state.document.mesh is not None and bool(state.document.used)
        self._size.show(str(config.size))
        self._mode.show(config.mode)
        mesh = state.document.mesh
        self._layout.show(
            "own" if config.keep_uv else "new",
            visible=mesh is not None and mesh.corner_uv is not None,
        )
        self._unseen.show(config.unseen, options=_unseen_options(state))
        put(self._colour, "visible", config.unseen == "colour")
        put_value(self._colour, config.unseen_colour)
        put(self._bake, "disabled", not idle or not usable)
        self._format.show(choice.format)
        self._picture.show(choice.picture, visible=choice.format != "coloured ply")
        put(self._model, "disabled", state.texture is None or not idle)
        put(self._show, "visible", state.texture is not None)
        put_value(self._show, state.show_texture)
        put(self._coverage_folder, "visible", state.texture is not None)
        if state.texture is not None:
            put(self._coverage, "content", _coverage_html(state.texture))
        self._show_cameras(state, idle)
        put(self._text, "content", _text(state))

    def _show_cameras(self, state: State, idle: bool) -> None:
        choice = state.cameras_choice
        chosen = WRITTEN_FORMATS[choice.format]
        put_value(self._program, chosen.label)
        put(self._loses, "content", help_line(chosen.in_words))
        has_lens = state.document.has_lens
        is_flat = has_lens and choice.undistorted
        put(self._with_photos, "visible", chosen.is_beside_photos and not is_flat)
        put_value(self._with_photos, choice.with_photos)
        put(self._undistorted, "visible", has_lens)
        put_value(self._undistorted, choice.undistorted)
        put(self._cameras, "disabled", not state.document.photos or not idle)


def _text(state: State) -> str:
    if state.job is not None:
        return f"{in_markdown(state.job.title)} …"
    if state.run.status == "review":
        return "Accept or revert the refinement first."
    texture = state.texture
    if texture is None:
        return "Not made yet."
    doubts = list(texture.doubts)
    if not state.texture_is_current:
        took = (
            f"; the last time took {in_words(texture.took_s)}" if texture.took_s else ""
        )
        doubts.insert(
            0, f"Cameras, masks or settings have changed since. Make it again{took}."
        )
    return in_markdown(texture.summary) + "".join(
        f"\n\n⚠ {in_markdown(doubt)}" for doubt in doubts
    )


def _unseen_options(state: State) -> dict[str, Option]:
    mesh = state.document.mesh
    has_own = mesh is not None and has_own_colours(mesh)
    return {
        "diffuse": Option("Filled in", "Colours spread from seen neighbours."),
        "colour": Option("One colour", "It shows plainly what no photo saw."),
        "own": Option(
            "Scan's own colour", "The colours that the mesh came with.", has_own
        ),
    }


def _size(value: str) -> int | str:
    return value if value == "auto" else int(value)


def _coverage_html(texture: Texture) -> str:
    rows = [
        (escaped(f"rgb{colour}"), escaped(name), share)
        for name, share, colour in texture.coverage
    ]
    unseen = max(0.0, 1.0 - sum(share for _, _, share in rows))
    rows.append(("rgb(60,60,60)", "No photo", unseen))
    legend = "".join(
        f'<div style="display:flex;gap:8px;align-items:center"><span style="width:11px;'
        f'height:11px;border-radius:3px;background:{colour}"></span><span style="flex:1;'
        f'overflow:hidden;text-overflow:ellipsis">{name}</span><span>{100 * share:.0f} %'
        "</span></div>"
        for colour, name, share in rows
    )
    picture = base64.b64encode(texture.coverage_jpeg).decode()
    # A help line is faint; the picture's and legend's colours are to be the true ones.
    return (
        f'<div class="pr-help" style="opacity:1">{legend}<img alt="Which photo paints where" '
        f'src="data:image/jpeg;base64,{picture}" style="width:100%;margin-top:7px;'
        'border-radius:5px"><div style="opacity:.75">The texture laid flat: brighter '
        "where it is seen better.</div></div>"
    )


def _sending_to(client: viser.ClientHandle | None) -> Callable[[str, bytes], None]:
    if client is None:
        raise InputError("There is no page to send the file to.")
    return lambda name, content: client.send_file_download(
        name, content, save_immediately=True
    )
