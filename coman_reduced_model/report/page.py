# SPDX-License-Identifier: BSD-3-Clause
"""A page from parts: text, notices, tables and figures in sections. One file, nothing loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure

from ..resources import version
from .draw import Drawing, draw
from .figures import NoData


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: str = "text"


@dataclass(frozen=True)
class Notice:
    """What a reader must not overlook; `level` is info or warn."""

    text: str
    level: str = "info"
    kind: str = "notice"


@dataclass(frozen=True)
class Table:
    """Rows of texts below a head. The first column names the row; `strong` are the rows to stand out.

    Numbers are to be given with their unit in the head or in the cell, and align right (all but the first `words`
    columns).
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    words: int = 1
    strong: Sequence[int] = ()
    groups: Sequence[tuple[str, int]] = ()  # head above the head: text, and how many columns it spans
    folded: str = ""  # if given, the table is folded away under this title
    kind: str = "table"

    @property
    def labels(self) -> list[str]:
        """What each column is, its group included, for phones, where a row is a list."""
        groups = [text for text, span in self.groups for _ in range(span)] or [""] * len(self.head)
        return [f"{group}, {name}" if group else name for group, name in zip(groups, self.head, strict=True)]


@dataclass(frozen=True)
class Picture:
    """A figure with its caption."""

    drawing: Drawing
    caption: str
    kind: str = "picture"

    @property
    def svg(self) -> Markup:
        """The drawing as part of the page: made by matplotlib, which escapes the texts in it."""
        return Markup(self.drawing.svg)


Part = Text | Notice | Table | Picture


@dataclass(frozen=True)
class Section:
    """A heading and what is below it."""

    title: str
    parts: Sequence[Part]
    anchor: str = field(default="")


def picture(
    name: str, make: Callable[[], Figure], alt: str, caption: str, folder: Path | None = None
) -> Picture | Notice:
    """A figure for the page, and as PNG in the folder; the reason in its place where there is nothing to draw."""
    try:
        figure = make()
    except NoData as reason:
        return Notice(str(reason))
    return Picture(draw(name, figure, alt, folder), caption)


def page(title: str, lead: str, sections: Sequence[Section], facts: Sequence[tuple[str, str]] = ()) -> str:
    """The HTML of a report.

    Args:
        title: heading.
        lead: the result in one sentence, said first.
        sections: in order; those without parts are left out.
        facts: short things to know, name and value, below the lead.
    """
    filled = [
        Section(section.title, section.parts, section.anchor or f"s{number}")
        for number, section in enumerate(sections, 1)
        if section.parts
    ]
    return _template().render(title=title, lead=lead, sections=filled, facts=facts, version=version())


@cache
def _template() -> jinja2.Template:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.get_template("page.html.j2")
