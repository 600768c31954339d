"""The panels' buttons as commands: Ctrl+K finds them, whichever tab is open."""

import asyncio
import inspect

import viser

from app.web.controls import guarded_all, put


class ButtonCommands:
    """A command for every button that a page has when this is made."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._commands = [
            (button, _command(gui, button))
            for button in gui._gui_input_handle_from_uuid.values()
            if isinstance(button, viser.GuiButtonHandle)
        ]

    def show(self) -> None:
        """Lets the commands be called, and be possible, as the buttons are now."""
        for button, command in self._commands:
            put(command, "label", button.label)
            put(command, "disabled", button.disabled or not button.visible)


def _command(gui: viser.GuiApi, button: viser.GuiButtonHandle) -> viser.CommandHandle:
    command = gui.add_command(button.label, description=button.hint)

    @command.on_trigger
    @guarded_all
    async def _(event: viser.CommandEvent) -> None:
        if command.disabled:
            return
        pressed = viser.GuiEvent(event.client, event.client_id, button)
        for callback in button._impl.update_cb:
            if inspect.iscoroutinefunction(callback):
                await callback(pressed)
            else:
                await asyncio.to_thread(callback, pressed)

    return command
