"""The slider that brightens dark photos on screen: the same beside the scene and in it."""

import viser

from app.model.session import Session, setting
from app.web.controls import guarded

MAX_GAIN = 8.0


def add_photo_gain(
    gui: viser.GuiApi, session: Session, order: float | None = None
) -> viser.GuiSliderHandle[float]:
    """Adds the slider; whoever shows it puts the state's ``photo_gain`` into it."""
    slider = gui.add_slider(
        "Brighten",
        1.0,
        MAX_GAIN,
        0.1,
        1.0,
        hint="Dark photos on screen, so many times; the photos themselves stay.",
        order=order,
    )

    @slider.on_update
    @guarded
    def _(_: viser.GuiEvent) -> None:
        value = min(max(slider.value, 1.0), MAX_GAIN)
        session.change(None, setting(photo_gain=value))

    return slider
