"""What can be said of a refinement before it starts."""

import dataclasses

FEW = 0.1
"""Shares of overlap below this make a refinement doubtful."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Readiness:
    """What can be said of a refinement before it starts."""

    overlap: float | None
    """Of the surface points that any photo sees, the share that two or more see; None
    where there is but one photo, which is compared with the surface itself."""
    blind: tuple[str, ...]
    """Photos whose cameras do not see the surface."""
    alone: tuple[str, ...]
    """Photos that share hardly any of what they see with another one."""
    plain: tuple[str, ...]
    """Photos with too little texture on the surface."""
    masked: tuple[str, ...] = ()
    """Photos whose masks leave hardly anything of the surface."""
    featureless: tuple[str, ...] = ()
    """Photos with neither texture nor edges anywhere, as black ones."""
    same: tuple[tuple[str, str], ...] = ()
    """Photos that show one picture, pair by pair."""

    @property
    def is_possible(self) -> bool:
        """Whether a refinement can start."""
        if self.overlap is None:
            return not self.blind and not self.refusals
        return self.overlap > 0.0 and not self.refusals

    @property
    def refusals(self) -> tuple[str, ...]:
        """Why nothing could be measured in the photos at all, one sentence each."""
        return (
            *(
                f"The mask of {name} leaves hardly anything of the surface, so nothing "
                "can be compared there: clear the mask, mask less, or leave the photo "
                "out."
                for name in self.masked
            ),
            *(
                f"{name} shows neither texture nor edges anywhere, so no camera can be found for it: leave the photo out, or take "
                "another."
                for name in self.featureless
            ),
            *(
                f"{first} and {second} are the same picture, so there is nothing "
                "to compare: leave one of them out."
                for first, second in self.same
            ),
        )

    @property
    def problems(self) -> tuple[str, ...]:
        """What stands in the way and what to do about it, one sentence each."""
        found = list(self.refusals)
        found += [
            f"The camera of {name} sees nothing of the surface: align it in tab 2."
            for name in self.blind
        ]
        lacking = (
            "texture on the surface: colours cannot decide there; only the outline can"
        )
        if self.overlap is None:
            lacking = "shading or texture on the surface: only its outline can decide"
        elif self.overlap == 0.0 and not self.masked:
            found.append(
                "No part of the surface is seen by two photos, so they cannot be "
                "compared: align the cameras, or take photos from nearer viewpoints."
            )
        elif self.overlap < FEW:
            found.append(
                "The photos hardly overlap on the surface: the answer would be "
                "poorly determined. Align better, or take photos from nearer viewpoints."
            )
        if self.overlap is not None and self.overlap >= FEW:
            found += [
                f"{name} shares hardly any surface with the other photos: only its "
                "outline will hold it in place."
                for name in self.alone
            ]
        found += [
            f"{name} shows hardly any {lacking}."
            for name in self.plain
            if name not in self.featureless
        ]
        return tuple(found)
