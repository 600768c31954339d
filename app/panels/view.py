"""The upper part of the Align tab: how this browser looks at the scene.

Each browser has its own: what it shows depends on its own view.
"""

import time

import viser

from app.control.controller import Controller
from app.model.session import setting
from app.model.state import State
from app.panels.photo_gain import add_photo_gain
from app.scene.viewport import Mode, Viewport
from app.web.bridge import Bridge
from app.web.controls import guarded, put, put_value
from app.web.styles import PHOTO_STYLES, THROUGH_STYLES
from app.web.widgets import Choice, Option

MODES: dict[Mode, Option] = {
    "free": Option(
        "3-D scene",
        "Walk around the scene. Drag the coloured arrows and arcs to place the camera.",
    ),
    "inspect": Option(
        "Look through",
        "See the model through the photo; the camera stays. Wheel zooms, drag pans.",
    ),
    "move": Option(
        "Move the camera",
        "Look through and move the camera: drag to orbit, right drag to pan, wheel: "
        "closer, farther.",
    ),
}
GIZMOS = {
    "move": Option("Shift and turn", "At the camera: arrows shift it, arcs turn it."),
    "orbit": Option("Around the object", "Arcs carry the camera around the object."),
}


MAX_ZOOM = 32.0
SLIDER_REST_S = 1.0


class ViewPanel:
    """One browser's controls of its view."""

    def __init__(
        self, viewport: Viewport, controller: Controller, bridge: Bridge, order: float
    ) -> None:
        self._viewport = viewport
        self._bridge = bridge
        self._zoomed_at = 0.0
        session, gui = controller.session, viewport.client.gui
        orders = (order + 0.01 * i for i in range(1, 99))
        self._mode = Choice(
            gui,
            bridge,
            "View",
            MODES,
            lambda _, value: viewport.choose(_mode(value)),
            next(orders),
        )
        self._gizmo = Choice(
            gui,
            bridge,
            "Handles",
            GIZMOS,
            lambda _, value: session.change(None, setting(gizmo=value)),
            next(orders),
        )
        self._zoom = gui.add_slider(
            "Zoom",
            1.0,
            MAX_ZOOM,
            0.1,
            1.0,
            hint="Photo and mesh together; the camera stays. The wheel zooms, too.",
            order=next(orders),
            visible=False,
        )
        self._style = Choice(
            gui,
            bridge,
            "Show",
            THROUGH_STYLES,
            lambda _, value: session.change(None, setting(through_style=value)),
            next(orders),
        )
        self._photo_style = Choice(
            gui,
            bridge,
            "Style",
            PHOTO_STYLES,
            lambda _, value: session.change(None, setting(overlay_style=value)),
            next(orders),
        )
        self._opacity = gui.add_slider(
            "Opacity",
            0.0,
            1.0,
            0.01,
            0.55,
            hint="Of the mesh over the photo.",
            order=next(orders),
            visible=False,
        )
        self._share = gui.add_slider(
            "Share",
            0.0,
            1.0,
            0.01,
            0.5,
            hint="How much of the other photo is mixed in, or where the line is.",
            order=next(orders),
            visible=False,
        )

        self._gain = add_photo_gain(gui, session, next(orders))

        @self._zoom.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            self._zoomed_at = time.monotonic()
            viewport.set_zoom(self._zoom.value)

        @self._opacity.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            value = min(max(self._opacity.value, 0.0), 1.0)
            session.change(None, setting(mesh_opacity=value))

        @self._share.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            value = min(max(self._share.value, 0.0), 1.0)
            session.change(None, setting(overlay_share=value))

    def forget(self) -> None:
        """The browser has left."""
        for choice in (self._mode, self._gizmo, self._style, self._photo_style):
            choice.forget(self._bridge)

    def show(self, state: State) -> None:
        """Makes the controls as the view and ``state`` have them."""
        mode, style = self._viewport.mode, state.through_style
        through = mode != "free"
        has_photo = bool(state.document.photos)
        self._mode.show(
            mode,
            options={
                key: option._replace(enabled=key == "free" or has_photo)
                for key, option in MODES.items()
            },
        )
        self._gizmo.show(state.gizmo, visible=not through and has_photo)
        put(self._zoom, "visible", mode == "inspect")
        if time.monotonic() - self._zoomed_at > SLIDER_REST_S:
            # The browser's answer lags behind a hand on the slider.
            zoom = min(max(self._viewport.zoom, 1.0), MAX_ZOOM)
            put_value(self._zoom, round(zoom, 1))
        two = len(state.document.used) > 1
        self._style.show(
            style,
            visible=through,
            options={
                key: option._replace(enabled=two or key != "photo")
                for key, option in THROUGH_STYLES.items()
            },
        )
        photos = through and style == "photo"
        self._photo_style.show(state.overlay_style, visible=photos)
        put(self._opacity, "visible", through and style not in ("photo", "lines"))
        put_value(self._opacity, state.mesh_opacity)
        put(
            self._share,
            "visible",
            photos and state.overlay_style in ("blend", "swipe"),
        )
        put_value(self._share, state.overlay_share)
        # The others show pictures that the engine has drawn, with their own light.
        put(self._gain, "visible", through and style not in ("photo", "normals"))
        put_value(self._gain, state.photo_gain)


def _mode(value: str) -> Mode:
    return next(mode for mode in MODES if mode == value)
