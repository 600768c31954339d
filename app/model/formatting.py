"""Names as there is room for them."""


def shortened(text: str, most: int) -> str:
    """A name for where there is room for ``most`` characters."""
    return text if len(text) <= most else f"{text[: most - 1].rstrip()}…"
