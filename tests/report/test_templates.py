"""Templates take no value unescaped, and none may be missing."""

import jinja2
import pytest

from photoreg.report.templates import part, rendered


def test_a_value_that_is_missing_is_an_error():
    with pytest.raises(jinja2.UndefinedError, match="mark"):
        rendered("triage.html")


def test_a_part_of_the_page_is_plain_text_with_its_values_escaped():
    text = part("data.html", "mesh", name="<b>\"'&", facts="")
    assert type(text) is str
    assert "&lt;b&gt;&#34;&#39;&amp;" in text
    assert "<b>" not in text
