"""What `static/layout.js` must know of viser's panels to fold them on narrow screens."""

import viser

from app.model.markup import mounted

LEFT_PX, MAIN_PX = 350, 324
"""Widths of the panels beside the scene."""


def dock(gui: viser.GuiApi, left: viser.PanelHandle) -> None:
    """Puts the panels beside the scene, and tells the page of them."""
    left.dock_left()
    left.set_width(LEFT_PX)
    gui.main_panel.dock_right()
    gui.main_panel.set_width(MAIN_PX)
    panels = {"left": left._impl.uuid, "main": gui.main_panel._placement_uuid}
    # The names of data attributes are in small letters, with hyphens.
    widths = {"left-width": str(LEFT_PX), "main-width": str(MAIN_PX)}
    gui.add_html(mounted("panels", **panels, **widths))
