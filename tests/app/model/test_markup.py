"""Words of other people in HTML and Markdown: they stay words."""

import dataclasses
import html.parser
import re
from pathlib import Path

import pytest
from viser import _messages

from app.control.controller import Controller
from app.control.run_control import report_of
from app.model.markup import escaped, in_markdown, mounted, sending
from app.model.pictures import Compare, Compared
from app.model.session import Session
from app.model.state import PointPair, State, WaitingProject
from app.page.server import Page
from app.panels import project
from app.panels.pair_table import pair_rows, table_html
from app.web.scripts import SCRIPTS
from photoreg.project.files import FileProblem
from photoreg.report.run_report import report_html
from photoreg.report.static_files import static_folder, static_text
from tests.app.model.hostile_words import WORDS, hostile_comparison, hostile_states


class Elements(html.parser.HTMLParser):
    """What a browser would make of HTML: tags, and names of attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def check_harmless(text: str) -> None:
    """Fails where something in HTML, or HTML in Markdown, would run or load."""
    for tag, attributes in Elements(text).tags:
        assert tag not in ("script", "iframe", "object", "embed", "base"), text
        assert "http-equiv" not in attributes, text
        assert not [name for name in attributes if name.startswith("on")], text
        assert attributes.get("src") != "x", text
        for name in ("src", "href", "action"):
            assert "script:" not in (attributes.get(name) or ""), text


@pytest.fixture(scope="module")
def shown():
    """All HTML, and all Markdown, that the page's panels send for the hostile states."""
    states = hostile_states()
    session = Session(State())
    controller = Controller(session, warm_up=False)
    page = Page(session, controller, port=0, shadows=False)
    found: dict[str, set[str]] = {"content": set(), "_markdown": set()}
    page._closed = True  # Its painter ends: the test paints.
    page._paint_soon()
    page._painter.join()
    try:
        for state in states:
            session._state = state
            page._is_changed, page._scene_at = True, -1e9
            page._paint()
            page.server.flush()
            buffer = page.server._websock_server._broadcast_buffer
            for message in list(buffer.message_from_id.values()):
                if isinstance(message, _messages.GuiUpdateMessage):
                    values = message.updates
                elif isinstance(message, _messages._CreateGuiComponentMessage):
                    values = vars(message.props)  # pyright: ignore[reportAttributeAccessIssue]
                else:
                    continue
                for name, texts in found.items():
                    if isinstance(values.get(name), str):
                        texts.add(values[name])
    finally:
        page.close()
        controller.close()
    return found


def test_no_panel_lets_words_become_markup(shown):
    for texts, least in ((shown["content"], 14), (shown["_markdown"], 5)):
        hostile = [text for text in texts if "window.hacked" in text]
        assert len(hostile) >= least, "the words reach the panels"
        for text in texts:
            check_harmless(text)
    for text in shown["_markdown"]:
        assert "](" not in text, "viser opens files that pictures in Markdown name"


def test_no_html_of_ours_has_script_in_an_attribute():
    rooms = [Path(f.__code__.co_filename).parent for f in (escaped, report_html)]
    paths = [path for room in rooms for path in room.glob("*.py")]
    for path in [*paths, *static_folder().glob("*.html")]:
        found = re.findall(r"[\s\"']on[a-z]+=\\?[\"'{]", path.read_text("utf-8"))
        assert not found, f"{path}: the page's policy forbids {found}"


def test_a_report_of_a_run_keeps_hostile_words_as_words():
    state = hostile_states()[-1]
    cameras = state.document.used_cameras
    asked = Compare(cameras, cameras, "blend", "clay")
    compared = Compared(asked, (hostile_comparison(),))
    text = report_html(report_of(state, compared))
    own = static_text("compare.js")
    assert text.count("<script>") == 1
    check_harmless(text.replace(f"<script>\n{own}</script>", ""))


def test_a_question_about_a_file_keeps_hostile_words_as_words():
    problem = FileProblem("key", Path("/somewhere") / WORDS, "missing")
    check_harmless(project._question(WaitingProject(WORDS, (problem,))))
    check_harmless(project._objection_html(WORDS))


def test_a_number_that_is_a_text_is_shown_as_text():
    """As in a project of somebody else; reading it is refused, this is the second line of defence."""
    state = hostile_states()[0]
    first = state.document.photos[0]
    number: int = WORDS  # pyright: ignore[reportAssignmentType]
    entry = dataclasses.replace(first, pairs=(PointPair(number, (0.0, 0.0, 0.0)),))
    document = dataclasses.replace(state.document, photos=(entry,))
    state = dataclasses.replace(state, document=document, solution=None)
    text = table_html(state, pair_rows(state))
    assert "window.hacked" in text
    check_harmless(text)


@pytest.mark.parametrize("quote", ['"', "'"])
def test_escaped_text_ends_no_attribute(quote):
    [(tag, attributes)] = Elements(f"<p title={quote}{escaped(WORDS)}{quote}>").tags
    assert (tag, attributes) == ("p", {"title": WORDS})


def test_messages_and_mounted_elements_carry_any_text_unharmed():
    [(_, attributes)] = Elements(f"<b {sending('act', name=WORDS)}>").tags
    assert list(attributes) == ["data-send"]
    [(_, attributes)] = Elements(mounted("kind", text=WORDS)).tags
    assert attributes["data-text"] == WORDS


def test_markdown_keeps_a_text_in_its_line_and_cell():
    text = in_markdown("a|b\n# c *d* <e> ![f](g.png)")
    assert not set("|\n#*<>![]") & set(re.sub(r"&#\d+;", "", text))
    assert html.unescape(text) == "a|b # c *d* <e> ![f](g.png)"


def test_every_script_of_the_page_is_a_file():
    for name in SCRIPTS:
        assert (static_folder() / f"{name}.js").is_file()
