"""The line that is always on screen: how well the photos agree, in a number and words."""

from app.model.markup import mounted
from app.model.state import Agreement, State
from photoreg.registration.verdict import Grade
from photoreg.report.templates import part

CLOSE, ROUGH = 0.9, 0.25
"""Shares of agreement. Of the demo 20 px off it is 0.6, 5 px off 0.97, 37 px off 0.1."""

TEAL, GREEN, AMBER, RED = "#2dbeaf", "#8bbf5a", "#e8a33d", "#e5645c"
GREY = "#98a2b3"

VERDICTS: dict[Grade, tuple[str, str]] = {
    "convincing": (TEAL, "✓"),
    "plausible": (GREEN, "≈"),
    "unconvincing": (AMBER, "!"),
}
"""The colour and the sign of how far cameras are to be believed."""

MEANING = (
    "100 %: every point of the surface has the same colour in all photos that see it. "
    "0 %: no more alike than unrelated photos."
)


def meter_html(state: State) -> str:
    """Agreement as a bar, a number and what it means."""
    found, used = state.agreement, state.document.used
    if state.document.mesh is None or not used:
        return _bar(0.0, GREY, "Photos agree: –", "A mesh and photos are needed.")
    if len(used) == 1:
        text = "One photo: nothing to compare it with but the surface, as Refine does."
        return _bar(0.0, GREY, "Photos agree: –", text)
    if found is None:
        return _bar(0.0, GREY, "Photos agree: …", "Being measured.")
    seen = f"{100 * found.share_seen:.0f} % of points seen by both"
    if len(used) > 2:
        seen = seen.replace("by both", "by two or more")
    if found.share is None:
        return _bar(0.0, RED, "Photos agree: –", f"Too little in common: {seen}.")
    grade = state.grade
    if grade is None:
        colour, word = closeness(found)
    else:
        # A run has judged these cameras; it knows more than how alike the colours are.
        (colour, _), word = VERDICTS[grade], grade
    return _bar(
        found.share,
        colour,
        f"Photos agree: {100 * found.share:.0f} %",
        f"{word[:1].upper()}{word[1:]} · {seen}",
    )


def closeness(found: Agreement) -> tuple[str, str]:
    """Colour and words for an agreement that no run has judged."""
    share = found.share or 0.0
    if share >= CLOSE:
        return TEAL, "close"
    return (AMBER, "rough") if share >= ROUGH else (RED, "far off")


def _bar(share: float, colour: str, title: str, text: str) -> str:
    content = part(
        "widgets.html",
        "meter",
        share=share,
        colour=colour,
        title=title,
        text=text,
        meaning=MEANING,
    )
    return mounted("head") + content
