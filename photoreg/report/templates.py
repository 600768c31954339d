"""HTML from the templates of `static/`: what is filled in is escaped, and none is missing."""

import functools
import json

import jinja2

from photoreg.report.static_files import static_text


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(static_text),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
    environment.globals |= {"static_text": static_text, "json": json.dumps}
    return environment


def rendered(template: str, /, **values: object) -> str:
    """A template with these values.

    Raises:
        jinja2.UndefinedError: if the template needs a value that is not given.
    """
    return _environment().get_template(template).render(values)


def part(template: str, macro: str, /, **values: object) -> str:
    """What a macro of a template makes of these values."""
    # A plain text: what is rendered is of a class that escapes what is added to it.
    return str(getattr(_environment().get_template(template).module, macro)(**values))
