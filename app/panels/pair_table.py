"""The table of a photo's point pairs, and what the solution says of them, as HTML."""

from typing import Any

import numpy as np

from app.model import point_pairs
from app.model.markup import escaped, sending
from app.model.state import PointPair, State
from photoreg.resection.solver import N_FOCAL, N_POSE, N_PRINCIPAL

NEEDS = (
    f"{N_POSE} pairs give the pose, {N_FOCAL} also the focal length, {N_PRINCIPAL} also "
    "the principal point."
)


def pair_rows(state: State) -> list[dict[str, Any]]:
    """For each pair of the selected photo its residual, in words, and whether bad."""
    entry = state.selected_photo
    if entry is None:
        return []
    solution = state.current_solution
    left_out: set[int] = set()
    if solution is not None and solution.resection is not None:
        inliers = solution.resection.inliers
        left_out = {
            pair.number
            for pair, good in zip(solution.pairs, inliers, strict=True)
            if not good
        }
    residuals = point_pairs.residuals_px(entry, entry.camera)
    worst = max(residuals, key=lambda n: residuals[n], default=None)
    rows = []
    for pair in entry.pairs:
        residual = residuals.get(pair.number)
        if pair.world is None:
            text = "not yet on the model"
        elif pair.pixel is None:
            text = "not yet in the photo"
        elif residual is not None and np.isfinite(residual):
            text = f"{residual:.1f} px" if residual < 1000 else f"{residual:,.0f} px"
        else:
            text = "behind the camera"
        rows.append(
            {
                "number": pair.number,
                "text": text,
                "bad": pair.number in left_out,
                "worst": pair.number == worst and len(residuals) > 1,
            }
        )
    return rows


def table_html(state: State, rows: list[dict[str, Any]]) -> str:
    """The table of pairs, and above it what the solution says."""
    entry = state.selected_photo
    if entry is None:
        return ""
    return (
        f'<div style="margin:4px 12px;font-size:13px;line-height:1.4">'
        f"{_verdict_html(state)}{_rows_html(state, entry.name, rows)}</div>"
    )


def _verdict_html(state: State) -> str:
    entry, solution = state.selected_photo, state.current_solution
    assert entry is not None
    dim = ""
    if solution is None and state.solution and state.solution.photo is entry.photo:
        # Until the new one is there: a panel that shrinks for a moment would move the
        # photo under the hand.
        solution, dim = state.solution, ' style="opacity:.5"'
    n = len(entry.whole_pairs)
    if n < N_POSE:
        missing = N_POSE - n
        more = "One more pair" if missing == 1 else f"{missing} more pairs"
        return (
            f'<div style="opacity:.75;margin-bottom:6px">{more} to place the camera. '
            f"{NEEDS}</div>"
        )
    if solution is None or len(solution.pairs) < N_POSE:
        return '<div style="opacity:.75;margin-bottom:6px">Solving …</div>'
    if solution.resection is None:
        return f"<div{dim}>{_note_html(solution.problem, bad=True)}</div>"
    resection = solution.resection
    error = resection.expected_error_px
    colour = "#2dbeaf" if error < 20 and not resection.warnings else "#e8a33d"
    text = (
        f'<div style="margin-bottom:6px"><span style="font-size:18px;font-weight:650;'
        f'color:{colour}">± {error:.1f} px</span> expected over the surface<br>'
        f'<span style="opacity:.75">{escaped(resection.summary)}</span></div>'
    )
    left_out = bool((~resection.inliers).any())
    text += "".join(
        _note_html(_by_number(warning, solution.pairs), bad=left_out and i == 0)
        for i, warning in enumerate(resection.warnings)
    )
    return f"<div{dim}>{text}</div>"


def _by_number(warning: str, pairs: tuple[PointPair, ...]) -> str:
    """The engine counts whole pairs from 1; the markers have numbers of their own."""
    numbers = [pair.number for pair in pairs]
    if numbers == list(range(1, len(numbers) + 1)):
        return warning
    head, sep, tail = warning.partition(" do")
    words = head.replace(",", "").replace(" and", "").split()
    if not sep or not words or words[0] not in ("Pair", "Pairs"):
        return warning
    named = [str(numbers[int(word) - 1]) for word in words[1:] if word.isdigit()]
    listed = named[-1:] if len(named) == 1 else [", ".join(named[:-1]), named[-1]]
    return f"{words[0]} {' and '.join(listed)}{sep}{tail}"


def _note_html(text: str, bad: bool) -> str:
    colour = "255,95,86" if bad else "232,163,61"
    return (
        f'<div style="border-left:3px solid rgb({colour});padding:4px 8px;'
        f"background:rgba({colour},.12);border-radius:0 5px 5px 0;margin-bottom:6px"
        f'">{escaped(text)}</div>'
    )


def _rows_html(state: State, name: str, rows: list[dict[str, Any]]) -> str:
    if not rows:
        return ""
    cells = []
    for row in rows:
        number = row["number"]
        delete = escaped(f"Delete point {number}")
        colour = "#ff5f56" if row["bad"] else "#e8a33d" if row["worst"] else "inherit"
        remark = "does not fit" if row["bad"] else "largest" if row["worst"] else ""
        back = "rgba(45,190,175,.22)" if number == state.chosen_pair else "none"
        cells.append(
            f'<tr style="cursor:pointer;background:{back}" '
            f"{sending('choose', photo=name, number=number)}>"
            f'<td style="padding:2px 6px;font-weight:650">{escaped(number)}</td>'
            f'<td style="text-align:right;color:{colour};'
            f'font-variant-numeric:tabular-nums">{escaped(row["text"])}</td>'
            f'<td style="padding-left:8px;color:{colour};opacity:.85">{remark}</td>'
            f'<td style="text-align:right"><button aria-label="{delete}" '
            f'title="{delete}" style="{_CROSS}" '
            f"{sending('delete', photo=name, number=number)}>✕</button></td>"
            "</tr>"
        )
    head = '<tr style="opacity:.6;font-size:12px"><td style="padding:0 6px">Point</td>'
    head += '<td style="text-align:right">Off by</td><td></td><td></td></tr>'
    return (
        '<table style="width:100%;border-collapse:collapse">'
        f"{head}{''.join(cells)}</table>"
    )


_CROSS = (
    "background:none;border:0;color:inherit;opacity:.6;cursor:pointer;font:inherit;"
    "padding:0 6px"
)
