"""What a comparison shows of one photo."""

import dataclasses


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PhotoComparison:
    """Before and after in one photo; all pictures are JPEG files."""

    name: str
    carried: str
    """Name of the photo carried over into it."""
    before: bytes
    after: bytes
    disagreement_before: bytes
    """Empty, as the next, where there is no other photo."""
    disagreement_after: bytes
    levels_before: float | None
    """Mean disagreement in grey levels of 255; None where nothing is shared."""
    levels_after: float | None
