"""Checks the built site: `python -m docs.check_site build/docs`.

Every link within it leads to a page and a place that are there, and nothing is fetched
from elsewhere when a page is read.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

FETCHED = {"script": "src", "img": "src", "link": "href", "iframe": "src"}
"""What a browser fetches by itself, and by which attribute."""


class _Page(HTMLParser):
    """The places, the links and the fetched files of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value for name, value in attrs if value}
        self.places |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        name = FETCHED.get(tag)
        is_fetched = tag != "link" or values.get("rel") not in (
            "canonical",
            "next",
            "prev",
        )
        if name in values and is_fetched:
            self.fetched.append(values[name])


def faults(site: Path) -> list[str]:
    """A line for each link that leads nowhere and each file fetched from elsewhere."""
    pages = {path.resolve(): _Page(path) for path in sorted(site.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        where = path.relative_to(site.resolve())
        for address in page.fetched:
            if urlsplit(address).netloc:
                found.append(f"{where}: {address} is fetched from elsewhere.")
        for address in {*page.links, *page.fetched}:
            parts = urlsplit(address)
            # Only the page of faults is read from any folder, and links from the top.
            if parts.scheme or parts.netloc or path.name == "404.html":
                continue
            target = (
                (path.parent / unquote(parts.path)).resolve() if parts.path else path
            )
            if target.is_dir():
                target /= "index.html"
            if not target.exists():
                found.append(f"{where}: {address} leads nowhere.")
            elif (
                parts.fragment
                and target in pages
                and unquote(parts.fragment) not in pages[target].places
            ):
                found.append(f"{where}: {address}: there is no such place.")
    return found


def main() -> int:
    """Prints the faults of the folder given; returns the exit status."""
    site = Path(sys.argv[1])
    found = faults(site)
    n = len(list(site.rglob("*.html")))
    print(*found, f"{n} pages, {len(found)} faults.", sep="\n")
    return 1 if found or n == 0 else 0


if __name__ == "__main__":
    sys.exit(main())
