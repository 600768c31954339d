"""HTML from the templates of `static/`: what is filled in is escaped, and none is missing."""

import functools

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
    environment.globals["static_text"] = static_text
    return environment


def rendered(name: str, **values: object) -> str:
    """The template ``name`` with these values.

    Raises:
        jinja2.UndefinedError: if the template needs a value that is not given.
    """
    return _environment().get_template(name).render(values)
