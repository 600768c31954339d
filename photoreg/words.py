"""Words of the sentences that photoreg says, and names as they are compared."""

import unicodedata
from collections.abc import Sequence


def listed(words: Sequence[str]) -> str:
    """One or more words as they stand in a sentence: a; a and b; a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def nfc(name: str) -> str:
    """A name in Unicode's composed form: macOS and its zips have them decomposed."""
    return unicodedata.normalize("NFC", name)


def percent(share: float) -> str:
    """A share in [0, 1] as whole per cents; less than one is said as such."""
    return "less than 1 %" if 0.0 < share < 0.005 else f"{100.0 * share:.0f} %"
