"""The table and the page of what needs a look."""

import csv
import dataclasses
import html.parser
import io
import re
import shlex

from photoreg.batch.summary import COLUMNS, csv_of, page_of
from photoreg.formats.mark import is_marked
from photoreg.report.static_files import static_text
from tests.batch.triage_rows import HOSTILE, ROWS, make_results


class Elements(html.parser.HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)


def test_the_worst_is_first_and_then_the_largest_error(tmp_path):
    worse = dataclasses.replace(ROWS[0], name="worse", expected_error_px=0.5)
    page = page_of(tmp_path, (*ROWS, worse))
    names = [a["data-name"] for tag, a in Elements(page).tags if tag == "article"]
    assert names == [
        "dish",
        "ewer" + HOSTILE,
        "cup 100",
        "bowl 3",
        "worse",
        "cup 20",
        "amphora 12",
    ]


def test_hostile_words_stay_words(tmp_path):
    elements = Elements(page_of(tmp_path, ROWS))
    script = static_text("triage.js")
    assert sum(tag == "script" for tag, _ in elements.tags) == 1
    assert all(not name.startswith("on") for _, a in elements.tags for name in a)
    assert [a for tag, a in elements.tags if tag == "img" and a.get("src") == "x"] == []
    assert HOSTILE in "".join(elements.text).replace(script, "")
    # The command's own quoting keeps a shell from running what a name says.
    (copied,) = [
        str(a["data-copy"])
        for _, a in elements.tags
        if "hacked" in str(a.get("data-copy"))
    ]
    assert shlex.split(copied)[2] == str(tmp_path / ("ewer" + HOSTILE))


def test_every_object_has_the_command_that_opens_it(tmp_path):
    elements = Elements(page_of(tmp_path / "my results", ROWS))
    copied = {str(a["data-copy"]) for _, a in elements.tags if "data-copy" in a}
    assert f"photoreg app '{tmp_path}/my results/bowl 3'" in copied
    assert len(copied) == len(ROWS)


def test_the_table_has_every_object_and_is_known_as_ours(tmp_path):
    rows = list(csv.DictReader(io.StringIO(csv_of(ROWS))))
    assert [row["object"] for row in rows] == [row.name for row in ROWS]
    assert set(rows[0]) == set(COLUMNS)
    assert float(rows[2]["expected_error_px"]) == 12.5
    assert rows[4]["verdict"] == rows[4]["cost"] == ""
    page = make_results(tmp_path / "out")
    assert is_marked(page)
    assert is_marked(page.with_name("summary.csv"))
    foreign = tmp_path / "foreign.csv"
    foreign.write_text("object,made by me\n")
    assert not is_marked(foreign)


def test_the_page_names_no_other_host():
    for name in ("triage.html", "triage.js"):
        assert not re.search(r"https?://", static_text(name))
