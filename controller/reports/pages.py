"""What every page is made with: the templates, and the script that draws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape

from controller.recording.reader import Run
from controller.reports.section import Section, laid_out


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
    templates.globals["laid_out"] = laid_out
    templates.globals["labelled"] = _labelled
    return templates


def rendered(section: Section, run: Run, judged: bool) -> tuple[Markup, list[Markup]]:
    """A section's body by its template, and what is ours and not the paper's, one sentence each.

    The template is given the section's content, and on what bench the run is; nothing has a verdict unless it is
    `judged`.
    """
    bench = {"simulated": run.simulated, "bench": run.manifest.get("bench"), "judged": judged}
    template = environment().get_template(f"{section.template}.html.j2")
    module: Any = template.make_module({**section.content, "content": section.content, **bench})
    ours = module.ours().split("<li>") if hasattr(module, "ours") else []
    return Markup(module), [each for text in ours if (each := text.strip())]


def _labelled(svg: str, caption: Markup) -> Markup:
    """A picture with its caption as its label for a screen reader."""
    return Markup(str(svg).replace("<svg", f'<svg aria-label="{escape(caption.striptags())}"', 1))


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
