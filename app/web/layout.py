"""What `static/layout.js` must know of viser's panels to fold them on narrow screens."""

import viser

from app.model.markup import mounted


def panel_layout(gui: viser.GuiApi, left: viser.PanelHandle) -> str:
    """HTML that tells the page which panels there are."""
    return mounted("panels", left=left._impl.uuid, main=gui.main_panel._placement_uuid)
