"""Before and after as HTML that works by itself: swipe, blink, heat maps beside."""

import base64
from html import escape

from photoreg.overlay.disagreement_map import TOP_LEVELS
from photoreg.report.photo_comparison import PhotoComparison

SWIPE_STYLE = """<style>
.pr-swipe{position:relative;--x:50%;line-height:0;border-radius:6px;overflow:hidden}
.pr-swipe img{width:100%;display:block}
.pr-swipe img.before{position:absolute;inset:0;height:100%;
  clip-path:inset(0 calc(100% - var(--x)) 0 0)}
.pr-swipe i{position:absolute;top:0;bottom:0;left:var(--x);width:2px;margin-left:-1px;
  background:#fff;box-shadow:0 0 4px #000}
.pr-swipe b{position:absolute;top:8px;padding:2px 7px;border-radius:4px;font:12px/1.4
  sans-serif;color:#fff;background:rgba(0,0,0,.55)}
.pr-swipe input{position:absolute;inset:0;width:100%;height:100%;margin:0;opacity:0;
  cursor:ew-resize}
.pr-swipe.blink img.before{clip-path:none;animation:pr-blink 1.2s steps(1) infinite}
.pr-swipe.blink i,.pr-swipe.blink input{display:none}
@keyframes pr-blink{0%{opacity:1}50%{opacity:0}}
.pr-button{margin:8px 0 0;padding:4px 12px;border:1px solid rgba(128,140,155,.45);
  border-radius:5px;background:transparent;color:inherit;font:inherit;font-size:12.5px;
  cursor:pointer}
.pr-beside{display:grid;grid-template-columns:1fr 1fr;gap:6px;margin-top:10px}
.pr-beside img{width:100%;display:block;border-radius:6px}
.pr-beside span{font-size:12px;opacity:.8}
.pr-scale{height:8px;border-radius:4px;margin-top:8px;background:linear-gradient(90deg,
  #000004,#320a5e,#781c6d,#bc3754,#ed6925,#fbb61a,#fcffa4)}
.pr-ends{display:flex;justify-content:space-between;font-size:11.5px;opacity:.75}
</style>"""


def data_uri(jpeg: bytes) -> str:
    """A JPEG file as an address that holds it."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()


def comparison_html(photo: PhotoComparison, left: str) -> str:
    """Before and after in one photo: to be swiped, and heat maps beside each other.

    ``left`` says what is before: the start, or another run.
    """
    if not photo.disagreement_before:
        return swipe_html(photo.before, photo.after, left)
    return swipe_html(photo.before, photo.after, left) + beside_html(
        photo.disagreement_before,
        photo.disagreement_after,
        (photo.levels_before, photo.levels_after),
        left,
    )


def swipe_html(before: bytes, after: bytes, left: str) -> str:
    """Two pictures with a line between them to be dragged, and a button to blink."""
    return (
        '<div class="pr-swipe">'
        f'<img class="after" src="{data_uri(after)}" alt="now">'
        f'<img class="before" src="{data_uri(before)}" alt="{escape(left)}">'
        f'<i></i><b style="left:8px">{escape(left)}</b>'
        f'<b style="right:8px">now</b>'
        '<input type="range" min="0" max="100" step="0.1" value="50" '
        'aria-label="Line between before and after" '
        'title="Drag the line: before at its left, after at its right" '
        "data-swipe></div>"
        '<button class="pr-button" type="button" title="Shows before and after by '
        'turns: what jumps has moved" data-blink>Blink</button>'
    )


def beside_html(
    before: bytes, after: bytes, levels: tuple[float | None, float | None], left: str
) -> str:
    """Two heat maps beside each other, and their scale.

    Args:
        before: A JPEG file.
        after: Another one.
        levels: Their means, in grey levels.
        left: What is before.
    """
    words = [
        "nothing shared" if level is None else f"mean {level:.1f} levels"
        for level in levels
    ]
    return (
        '<div class="pr-beside">'
        f'<div><img src="{data_uri(before)}" alt="disagreement before">'
        f"<span>{escape(left)}: {words[0]}</span></div>"
        f'<div><img src="{data_uri(after)}" alt="disagreement now">'
        f"<span>now: {words[1]}</span></div></div>"
        '<div class="pr-scale"></div><div class="pr-ends"><span>photos agree</span>'
        f"<span>differ by {TOP_LEVELS:.0f} of 255 or more</span></div>"
    )
