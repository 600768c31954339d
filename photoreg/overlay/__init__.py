"""Pictures of a registration: photos carried over, disagreement, lines."""

from photoreg.overlay.pictures import BLUE as BLUE
from photoreg.overlay.pictures import EDGE_COLOUR as EDGE_COLOUR
from photoreg.overlay.pictures import GREY as GREY
from photoreg.overlay.pictures import ORANGE as ORANGE
from photoreg.overlay.pictures import AlignedPair as AlignedPair
from photoreg.overlay.pictures import LiveOverlay as LiveOverlay
from photoreg.overlay.pictures import OverlayMode as OverlayMode
from photoreg.overlay.pictures import blend as blend
from photoreg.overlay.pictures import carry_over as carry_over
from photoreg.overlay.pictures import checkerboard as checkerboard
from photoreg.overlay.pictures import compose as compose
from photoreg.overlay.pictures import difference as difference
from photoreg.overlay.pictures import edges as edges
from photoreg.overlay.pictures import swipe as swipe
