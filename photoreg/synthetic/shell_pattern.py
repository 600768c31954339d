"""The colours of a sea snail's shell: flames, bands and speckles along its growth."""

import dataclasses

import numpy as np
from jaxtyping import Float

from photoreg.synthetic.noise import SolidNoise
from photoreg.synthetic.render import decode_srgb
from photoreg.synthetic.shell import INSIDE, OUTSIDE, RIM, ShellForm, shell_places

BANDS = (1.0, 0.12, -0.62)
"""Angles around the tube of the spiral bands, where the flames are darkest."""
MEAN_COLOUR = np.array([0.55, 0.36, 0.21])
"""About the mean albedo, linear RGB; contrast scales the differences from it."""


def _colour(red: int, green: int, blue: int) -> tuple[float, ...]:
    return tuple(decode_srgb(np.array([red, green, blue], dtype=np.float64)).tolist())


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShellPattern:
    """Colours (linear RGB) and numbers of the pattern."""

    cream: tuple[float, ...] = _colour(241, 226, 198)
    """The pale ground."""
    sand: tuple[float, ...] = _colour(222, 186, 140)
    """The ground where it is darker."""
    flame: tuple[float, ...] = _colour(163, 88, 40)
    """Flames and speckles."""
    core: tuple[float, ...] = _colour(92, 46, 24)
    """The flames' dark middle where they cross the bands."""
    old: tuple[float, ...] = _colour(196, 142, 120)
    """What the oldest whorls are worn to."""
    enamel: tuple[float, ...] = _colour(247, 238, 221)
    """The lip and the pillar."""
    throat: tuple[float, ...] = _colour(186, 112, 78)
    """The inside, darker with depth."""
    flames: float = 10.0
    """Flames a turn."""
    zigzag: float = 0.75
    """How far the flames swing, in radians of their period."""


PATTERNS = (
    ShellPattern(),
    ShellPattern(
        flame=_colour(122, 84, 96),
        core=_colour(66, 42, 58),
        old=_colour(150, 120, 138),
        throat=_colour(176, 128, 148),
        flames=14.0,
        zigzag=1.1,
    ),
    ShellPattern(
        cream=_colour(236, 228, 196),
        flame=_colour(124, 108, 52),
        core=_colour(62, 58, 30),
        old=_colour(160, 142, 104),
        throat=_colour(190, 150, 92),
        flames=12.0,
        zigzag=0.5,
    ),
    ShellPattern(
        sand=_colour(236, 190, 150),
        flame=_colour(205, 106, 62),
        core=_colour(134, 58, 36),
        old=_colour(214, 150, 128),
        throat=_colour(214, 132, 104),
        flames=8.0,
        zigzag=0.9,
    ),
)
"""Patterns that seeds choose from; the first is the demo's."""


def shell_albedo(
    points: Float[np.ndarray, "n 3"],
    form: ShellForm,
    pattern: ShellPattern,
    noise: SolidNoise,
    contrast: float = 1.0,
) -> Float[np.ndarray, "n 3"]:
    """Linear RGB (n, 3) at points of the surface, in units of `shell_surface`."""
    cream, sand, flame_colour, core_colour, old, enamel, throat = (
        np.array(value) for value in dataclasses.astuple(pattern)[:7]
    )
    _, along, around, size, layer, beyond = shell_places(points, form).T
    # Features grow with the shell: the pattern is drawn in units of the tube's size.
    scale = np.sqrt(np.maximum(size, 0.04))[:, None]
    drift = noise(points, 0.9, octaves=2)
    warp = noise(points / scale, 2.2, octaves=3)
    grain = noise(points / scale, 9.0, octaves=5, gain=0.75)
    strands = np.column_stack([24.0 * along, 2.2 * around, size])
    growth = noise(strands, 1.0, octaves=3, gain=0.7)[:, 0]
    dots = noise(points / scale, 16.0, octaves=2, gain=0.5)

    colour = _mixed(cream, sand, _step(-0.6, 1.6, drift[:, 0] + 0.5 * warp[:, 1]))
    # Older whorls are worn to rose and brown.
    age = _step(0.75, 0.12, size)
    colour = _mixed(colour, old, 0.55 * age)

    band = np.zeros(len(points))
    for middle in BANDS:
        band += np.exp(-(((around - middle - 0.03 * warp[:, 2]) / 0.17) ** 2))
    # Flames follow the growth lines, waver, and zigzag where the bands cross them.
    wave = (
        pattern.flames * along
        + pattern.zigzag * np.sin(2.7 * around + 0.4)
        + 0.55 * warp[:, 0]
    )
    flame = np.sin(wave) + 0.25 * warp[:, 1] + 0.1 * grain[:, 0]
    width = 0.15 - 0.55 * band
    stripe = _step(width, width + 0.35, flame)
    core = _step(width + 0.35, width + 0.95, flame + 0.15 * grain[:, 1])
    pale = 1.0 - 0.55 * _step(-0.75, -1.35, around)
    colour = _mixed(colour, flame_colour, 0.82 * stripe * pale)
    colour = _mixed(
        colour, core_colour, 0.75 * core * (0.35 + 0.65 * np.minimum(band, 1.0))
    )

    # Brown speckles on the pale ground, ivory ones within the flames.
    brown_dots = _step(0.8, 1.3, dots[:, 0] + 0.35 * drift[:, 1])
    ivory_dots = _step(0.85, 1.4, dots[:, 1] + 0.2 * warp[:, 2])
    colour = _mixed(colour, flame_colour, 0.75 * brown_dots * (1.0 - stripe))
    colour = _mixed(colour, cream, 0.65 * ivory_dots * stripe)

    # Cords and finer threads: bright above, where the light comes from, dirt between.
    groove = 0.5 - 0.5 * np.cos(26.0 * around)
    tone = 1.0 - 0.12 * groove**2 + 0.07 * np.sin(26.0 * around)
    tone += 0.035 * np.sin(104.0 * around) * (1.0 - age)
    tone += 0.07 * growth + 0.07 * grain[:, 2]
    colour = colour * np.maximum(tone, 0.2)[:, None]

    inside = _mixed(
        _mixed(enamel, throat, _step(0.05, -1.0, along)),
        flame_colour,
        0.6 * _step(-0.8, -2.6, along),
    )
    inside = inside * (1.0 + 0.05 * growth + 0.05 * grain[:, 0])[:, None]
    worn = enamel * (1.0 + 0.05 * growth + 0.04 * grain[:, 0])[:, None]
    colour = np.where((layer == INSIDE)[:, None], inside, colour)
    # The pillar wears the lip's enamel, which runs out over the pattern beside it.
    callus = _step(0.14, -0.05, beyond + 0.07 * warp[:, 0])
    callus = np.where(layer == OUTSIDE, callus, np.where(layer == RIM, 1.0, 0.0))
    colour = _mixed(colour, worn, callus)
    return np.clip(MEAN_COLOUR + contrast * (colour - MEAN_COLOUR), 0.01, 0.95)


def _mixed(
    first: np.ndarray, second: np.ndarray, share: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 3"]:
    return first + share[:, None] * (second - first)


def _step(
    start: float | np.ndarray, end: float | np.ndarray, values: np.ndarray
) -> np.ndarray:
    """0 at ``start``, 1 at ``end``, smooth between; either may be the larger."""
    t = np.clip((values - start) / (end - start), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
