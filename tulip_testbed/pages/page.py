"""A page and its sections, filled into the template."""

from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup

from tulip_testbed.base.column import Column, printable
from tulip_testbed.base.result import flattened
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.run_file import Head
from tulip_testbed.experiments.saved_runs import RunResult
from tulip_testbed.pages.figures import Figure, plotly_script
from tulip_testbed.pages.pictures import Picture

TEMPLATE = "page.html.j2"
RUN = "Run"  # title of the values that no other table holds


@dataclass(frozen=True)
class Section:
    """A section of the page; empty parts are left out; a click unfolds `folded`, a heading with a text."""

    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    pictures: tuple[Picture, ...] = ()
    folded: tuple[tuple[str, str | Table], ...] = ()


@dataclass(frozen=True)
class Page:
    """The whole page.

    Attributes:
        verdict: "pass" or "fail", or a discovery's; "": there is none. sentence: its meaning,
            in one line or several.
        story: further sentences about the verdict.
        missing: one sentence for each picture that could not be drawn.
        searched: whether there is a box that searches the rows of the tables.
    """

    title: str
    verdict: str
    sentence: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    missing: tuple[str, ...] = field(default=())
    story: tuple[str, ...] = field(default=())
    searched: bool = False


def html(page: Page) -> str:
    """Return the page as one HTML file that loads nothing from the network."""
    figures = [figure for section in page.sections for figure in section.figures]
    return filled(TEMPLATE, page=page, figures=figures, plotly=Markup(plotly_script()), script=Markup)


def filled(template: str, **content: Any) -> str:
    """Fill in a template of this package; the content is escaped, unless it is `Markup`."""
    text = files("tulip_testbed.pages").joinpath(template).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=shown_value,
    )
    return environment.from_string(text).render(**content)


def shown_value(value: Any) -> Any:
    """Return a value without control characters, which a name or a text of a file may hold."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return "\n".join(map(printable, value.split("\n")))


def title_of(run: RunResult) -> str:
    """Return the title of a run's page; a run in memory has no name of its own."""
    name = "" if run.folder is None else f" {run.folder.resolve().name}"
    return f"{run.robot.name}: {run.kind}{name}"


def how_it_was_made(document: Head) -> Section:
    """Return the folded section of a run's settings, the values of its run.json."""
    parts: dict[str, list[list[Any]]] = {RUN: []}
    for name, value in flattened(document.to_json()).items():
        part, _, rest = name.partition(".")
        title, shown = (part.capitalize(), rest) if rest else (RUN, name)
        parts.setdefault(title, []).append([shown, value])
    columns = (Column("key"), Column("value"))
    tables = [Table(title, columns, rows) for title, rows in parts.items() if rows]
    return Section("How it was made", folded=tuple((f"{t.title} ({len(t.rows)} values)", t) for t in tables))


def imperfections_fact(scale: float) -> tuple[tuple[str, str], ...]:
    """Return the imperfections that were drawn, for the head of a page."""
    return (("imperfections", f"scale {scale:g}" if scale else "none: an exact laboratory"),)
