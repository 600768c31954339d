"""Draws the Mermaid flowchart of docs/architecture.md as SVG.

Material for MkDocs would fetch Mermaid from a server of others when the page is read.
"""

import re
from collections.abc import Mapping, Sequence

BOX, GAP, ROW = (118, 30), 16, 66
"""Width and height of a room, the gap between two, the height of a floor, in pixels."""

_FENCE = re.compile(r"```mermaid\n(.*?)```", re.DOTALL)
_NODE = re.compile(r'^\s*(\w+)\["([^"]+)"\]', re.MULTILINE)
_EDGE = re.compile(r"^\s*(\w+) --> (\w+)", re.MULTILINE)


def drawn(markdown: str) -> str:
    """A page with every flowchart replaced by its drawing."""
    return _FENCE.sub(lambda found: svg(found[1]), markdown)


def floors(nodes: Sequence[str], edges: Sequence[tuple[str, str]]) -> list[list[str]]:
    """The nodes from the top down, each above all that it leads to.

    Within a floor they are ordered by where their neighbours above stand.
    """
    below: Mapping[str, list[str]] = {
        node: [b for a, b in edges if a == node] for node in nodes
    }

    def height(node: str) -> int:
        return 1 + max(map(height, below[node]), default=-1)

    heights = {node: height(node) for node in nodes}
    rows: list[list[str]] = []
    place: dict[str, float] = {}
    for level in range(max(heights.values()), -1, -1):
        row = [node for node in nodes if heights[node] == level]
        row.sort(key=lambda node: _mean([place[a] for a, b in edges if b == node]))
        place |= {node: (i + 0.5) / len(row) for i, node in enumerate(row)}
        rows.append(row)
    return rows


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else 0.5


def svg(flowchart: str) -> str:
    """A flowchart of Mermaid as an SVG on one line, in the page's own colours."""
    names = dict(_NODE.findall(flowchart))
    edges = _EDGE.findall(flowchart)
    rows = floors(list(names), edges)
    width = max(map(len, rows)) * (BOX[0] + GAP)
    at = {
        node: ((i + 0.5) * width / len(row), ROW * (level + 0.5))
        for level, row in enumerate(rows)
        for i, node in enumerate(row)
    }
    parts = [
        # Markdown leaves alone what is in a div, underscores too.
        f'<div><svg viewBox="0 0 {width} {ROW * len(rows)}" role="img" class="rooms" '
        'aria-label="Which room imports which"><defs><marker id="tip" '
        'viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0L8 4L0 8z" fill="currentColor"/></marker></defs>'
    ]
    for a, b in edges:
        (x0, y0), (x1, y1) = at[a], at[b]
        y0, y1 = y0 + BOX[1] / 2, y1 - BOX[1] / 2
        bend = (y1 - y0) / 2
        parts.append(
            f'<path d="M{x0:.0f} {y0:.0f}C{x0:.0f} {y0 + bend:.0f} {x1:.0f} '
            f'{y1 - bend:.0f} {x1:.0f} {y1:.0f}" class="arrow" marker-end="url(#tip)"/>'
        )
    for node, (x, y) in at.items():
        package = node.split("_")[0]
        parts.append(
            f'<rect x="{x - BOX[0] / 2:.0f}" y="{y - BOX[1] / 2:.0f}" width="{BOX[0]}" '
            f'height="{BOX[1]}" rx="5" class="{package}"/><text x="{x:.0f}" '
            f'y="{y + 5:.0f}">{"app." if package == "app" else ""}{names[node]}</text>'
        )
    return "".join([*parts, "</svg></div>"])
