"""The page of what needs a look, opened from the disk."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.batch.triage_rows import HOSTILE, make_results


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return make_results(tmp_path_factory.mktemp("batch") / "results of May").parent


@pytest.fixture
def page(chromium: Browser, folder: Path) -> Iterator[Page]:
    context = chromium.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    page.goto((folder / "index.html").as_uri())
    yield page
    context.close()


def test_the_worst_is_first_and_the_pictures_are_there(page: Page):
    expect(page.locator("article h2").first).to_have_text("dish")
    for picture in page.locator("article img").all():
        picture.scroll_into_view_if_needed()
        expect(picture).to_have_js_property("complete", True)
        assert picture.evaluate("e => e.naturalWidth") == 480
    assert page.evaluate("window.hacked") is None


def test_it_is_sorted_by_error_and_by_name(page: Page):
    page.get_by_label("Sort").select_option("error")
    expect(page.locator("article h2").first).to_have_text("cup 100")
    page.get_by_label("Sort").select_option("name")
    expect(page.locator("article h2").first).to_have_text("amphora 12")
    # As people count: 20 before 100.
    names = page.locator("article:visible h2")
    expect(names.nth(2)).to_have_text("cup 20")
    expect(names.nth(3)).to_have_text("cup 100")
    page.get_by_label("Sort").select_option("rank")
    expect(page.locator("article h2").first).to_have_text("dish")


def test_it_is_filtered_by_verdict_and_by_name(page: Page):
    visible = page.locator("article:visible")
    page.get_by_role("button", name="unconvincing 1").click()
    expect(visible).to_have_count(1)
    page.get_by_role("button", name="failed 1").click()
    expect(visible).to_have_count(2)
    page.get_by_role("button", name="unconvincing 1").click()
    expect(page.locator("article:visible h2")).to_have_text(["dish"])
    page.get_by_role("button", name="failed 1").click()
    page.get_by_label("Find an object").fill("CUP")
    expect(visible).to_have_count(2)
    page.get_by_label("Find an object").fill("nothing like it")
    expect(visible).to_have_count(0)
    expect(page.get_by_text("No object is like this.")).to_be_visible()


def test_the_command_is_copied(page: Page, folder: Path):
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    row = page.locator("article", has_text="bowl 3")
    row.get_by_role("button", name="Copy").click()
    expect(row.get_by_role("button", name="Copied")).to_be_visible()
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied == f"photoreg app '{folder}/bowl 3'"


def test_no_request_leaves_the_page(chromium: Browser, folder: Path):
    page = chromium.new_page()
    asked: list[str] = []
    problems: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: problems.append(message.text))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto((folder / "index.html").as_uri())
    for row in page.locator("article").all():
        row.scroll_into_view_if_needed()
    page.get_by_label("Sort").select_option("name")
    expect(page.locator("article h2").first).to_have_text("amphora 12")
    beyond = [
        url for url in asked if not url.startswith((folder.as_uri() + "/", "data:,"))
    ]
    assert not beyond
    assert len(asked) > 4
    assert problems == []
    # Not even where something would: the page's own policy forbids it.
    blocked = page.evaluate(
        "fetch('https://example.org').then(() => 'went', () => 'blocked')"
    )
    assert blocked == "blocked"
    page.close()


def test_hostile_names_are_shown_as_they_are(page: Page):
    expect(page.locator("article h2").nth(1)).to_have_text("ewer" + HOSTILE)
