"""The lines of help of buttons: viser takes them, and its page does not show them."""

import json

import viser

from app.model.markup import mounted


def button_hints(gui: viser.GuiApi) -> str:
    """HTML that has the page show the hint of every button as its title."""
    hints = {
        handle._impl.uuid: handle.hint
        for handle in gui._gui_input_handle_from_uuid.values()
        if isinstance(handle, viser.GuiButtonHandle | viser.GuiUploadButtonHandle)
        and handle.hint
    }
    return mounted("hints", hints=json.dumps(hints))
