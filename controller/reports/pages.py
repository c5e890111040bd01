"""What every page is made with: the templates, and the script that draws."""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape


def environment() -> Environment:
    """The templates; what is put into them is text, and bears a typesetter's apostrophes."""
    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        finalize=_typographic,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["breakable"] = _breakable
    return templates


def library() -> list[Markup]:
    """The scripts that draw, from Bokeh; "</script" would end the element that they stand in."""
    from bokeh.resources import Resources  # a tenth of a second, for pages alone

    texts = Resources(mode="inline", components=["bokeh", "bokeh-api"]).js_raw
    return [Markup(text.replace("</script", "<\\/script")) for text in texts]


def _breakable(name: str) -> Markup:
    """A column's name, such as a setting's path, that may go on in the next line after each of its parts."""
    return Markup(str(escape(_typographic(name))).replace(".", ".<wbr>").replace("_", "_<wbr>"))


def _typographic(value: object) -> object:
    return value.replace("'", "\u2019") if type(value) is str else value  # Markup is left alone
