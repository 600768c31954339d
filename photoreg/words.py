"""Words and numbers of the sentences that photoreg says, and names as they are compared."""

import unicodedata
from collections.abc import Sequence


def listed(words: Sequence[str]) -> str:
    """One or more words as they stand in a sentence: a; a and b; a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def some_of(words: Sequence[str]) -> str:
    """The first three words, and whether there are more: a, b, c ..."""
    return ", ".join(words[:3]) + (" ..." if len(words) > 3 else "")


def nfc(name: str) -> str:
    """A name in Unicode's composed form: macOS and its zips have them decomposed."""
    return unicodedata.normalize("NFC", name)


def percent(share: float) -> str:
    """A share in [0, 1] as whole per cents; less than one is said as such."""
    return "less than 1 %" if 0.0 < share < 0.005 else f"{100.0 * share:.0f} %"


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
