"""Numbers and durations as a person would write them."""


def number(text: float, digits: int = 3) -> str:
    """A number with so many significant digits, without an exponent where possible."""
    if text == 0 or not 1e-4 <= abs(text) < 1e7:
        return f"{text:.{digits - 1}e}"
    return f"{text:.{digits}g}" if abs(text) < 10 ** (digits - 1) else f"{text:,.0f}"


def in_words(seconds: float) -> str:
    """A duration as a person would say it."""
    if seconds < 1.0:
        return "under 1 s"
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


def shortened(text: str, most: int) -> str:
    """A name for where there is room for ``most`` characters."""
    return text if len(text) <= most else f"{text[: most - 1].rstrip()}…"
