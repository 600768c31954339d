"""Settings of texture baking."""

import dataclasses
from typing import Literal, get_args

from photoreg.errors import InputError

MIN_SIZE, MAX_SIZE = 64, 8192

UnseenMode = Literal["diffuse", "colour", "own"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class TextureConfig:
    """Settings of texture baking."""

    size: int | Literal["auto"] = "auto"
    """Texels on the longer side; "auto": somewhat finer than the photos'
    pixels on the surface, a multiple of 64, at most 8192."""
    mode: Literal["blend", "best"] = "blend"
    """"blend": photos blend into each other; detail comes from the best view. "best":
    each texel from its best photo alone, with visible seams between photos."""
    unseen: UnseenMode = "diffuse"
    """What no photo sees: colours spread from the neighbours, one colour, or the mesh's
    own colours (its texture, or else those of its vertices)."""
    unseen_colour: tuple[int, int, int] = (128, 128, 128)
    """The colour of what no photo sees, where it is to have one (or has no seen
    neighbour at all)."""
    even_exposure: bool = True
    """Multiply each photo's channels so that photos agree where both see."""
    leave_out_strangers: bool = True
    """Where three photos or more see a place and one disagrees, as something stands
    before the object there, do not paint from that one."""
    keep_uv: bool = True
    """Keep the mesh's own texture coordinates, if it has any that can hold a texture;
    else it is laid out anew."""
    max_angle_deg: float = 78.0
    """Surface seen at a larger angle from its normal is not painted, in (0, 90)."""
    margin: float = 0.003
    """Nearest to a silhouette, a jump in depth or the photo's border that colours are
    taken, as a share of the photo's longer side, but at least 2 pixels: lenses
    and errors of registration mix colours there."""
    feather: float = 0.03
    """Over this share of the photo's longer side its weight grows from such an edge."""

    def __post_init__(self) -> None:
        if self.size != "auto" and not MIN_SIZE <= self.size <= MAX_SIZE:
            raise InputError(
                f"The texture's size is {self.size}; give {MIN_SIZE} to {MAX_SIZE} "
                'texels, or "auto".'
            )
        if self.mode not in ("blend", "best"):
            raise InputError(f'mode is {self.mode!r}; give "blend" or "best".')
        if self.unseen not in get_args(UnseenMode):
            raise InputError(
                f"unseen is {self.unseen!r}; give one of "
                f"{', '.join(get_args(UnseenMode))}."
            )
        if len(self.unseen_colour) != 3 or not all(
            0 <= value <= 255 for value in self.unseen_colour
        ):
            raise InputError(
                f"unseen_colour is {self.unseen_colour}; give red, green and blue in "
                "0 to 255."
            )
        if not 0.0 < self.max_angle_deg < 90.0:
            raise InputError(
                f"max_angle_deg is {self.max_angle_deg}; give an angle between 0 and 90."
            )
        for name in ("margin", "feather"):
            value = getattr(self, name)
            if not 0.0 <= value <= 0.5:
                raise InputError(f"{name} is {value}; give a share in [0, 0.5].")
