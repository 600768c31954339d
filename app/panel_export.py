"""Tab 4, Export: the textured model and the cameras."""

from pathlib import Path

import viser

from app.conductor import Conductor
from app.controls import guarded, put, put_value
from app.session import setting
from app.state import State
from photoreg.errors import InputError


class ExportPanel:
    """Controls of the Export tab."""

    def __init__(self, gui: viser.GuiApi, conductor: Conductor) -> None:
        session = conductor.session
        gui.add_markdown("The photos as one texture on the mesh.")
        self._bake = gui.add_button("Make the texture", icon=viser.Icon.BRUSH)
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._text = gui.add_markdown("")
        self._show = gui.add_checkbox("Show it on the model", True, visible=False)
        self._model = gui.add_button(
            "Export textured OBJ (zip)", icon=viser.Icon.DOWNLOAD, disabled=True
        )
        gui.add_markdown("OBJ, MTL and PNG in one archive, for any 3-D program.")
        gui.add_divider()
        self._cameras = gui.add_button(
            "Export cameras.json", icon=viser.Icon.CAMERA, color="gray"
        )
        gui.add_markdown("For photoreg's command line and for this app's Data tab.")

        @self._bake.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            conductor.bake()

        @self._show.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(show_texture=self._show.value))

        @self._model.on_click
        @guarded
        def _(event: viser.GuiEvent) -> None:
            state = session.state
            if state.texture is None or event.client is None:
                raise InputError("Make the texture first.")
            name = Path(state.document.mesh.name if state.document.mesh else "model")
            event.client.send_file_download(
                f"{name.stem}-textured.zip",
                state.texture.archive,
                save_immediately=True,
            )

        @self._cameras.on_click
        @guarded
        def _(event: viser.GuiEvent) -> None:
            assert event.client is not None
            event.client.send_file_download(
                "cameras.json", conductor.cameras_text().encode(), save_immediately=True
            )

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        job = state.job
        idle = state.run.status == "idle" and job is None
        usable = state.document.mesh is not None and bool(state.document.used)
        put(self._bake, "disabled", not idle or not usable)
        put(self._bar, "visible", job is not None)
        if job is not None:
            put_value(self._bar, round(100.0 * job.fraction, 1))
        put(self._model, "disabled", state.texture is None or job is not None)
        put(self._show, "visible", state.texture is not None)
        put_value(self._show, state.show_texture)
        put(self._cameras, "disabled", not state.document.photos)
        text = "Not made yet."
        if job is not None:
            text = f"{job.title} …"
        elif state.texture is not None:
            text = state.texture.summary
            if not state.texture_is_current:
                text += "\n\n⚠ The cameras have changed since. Make it again."
        elif state.run.status == "review":
            text = "Accept or revert the refinement first."
        put(self._text, "content", text)
