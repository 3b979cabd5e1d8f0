# SPDX-License-Identifier: BSD-3-Clause
"""Write tables of doc/configuration.md (parameters, effects), doc/archive.md and the schema of its rows from the code.

python doc/generate.py             # after a parameter or an effect has changed
python doc/generate.py --check     # exit code 1 if a page is not up to date; a test does this
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

from coman_reduced_model import schemas
from coman_reduced_model.archive.tables import TABLES, json_schema
from coman_reduced_model.core.base.parameter import Parameter
from coman_reduced_model.core.config.schema import parameter_table
from coman_reduced_model.core.effects.catalogue import CATALOGUE

HERE = Path(__file__).parent
PLACES = {"robot": "", "axis": "axis", "side": "leg", "foot": "foot", "joint": "joint", "link": "link"}


def main() -> None:
    """Write the pages, or check them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 if the page would change")
    check = parser.parse_args().check
    for name, texts in PAGES.items():
        page = HERE / name
        made = {key: make() for key, make in texts.items()}
        write(page, generated(name, page.read_text(encoding="utf-8"), made), check)
    write(Path(schemas.__file__).parent / "archive.schema.json", json.dumps(json_schema(), indent=1) + "\n", check)


def write(path: Path, text: str, check: bool) -> None:
    """Write a file, or end with exit code 1 if it would change."""
    if check and (not path.exists() or path.read_text(encoding="utf-8") != text):
        sys.exit(f"{path.name} is not up to date: run python doc/generate.py")
    path.write_text(text, encoding="utf-8")


def generated(file: str, page: str, texts: dict[str, str]) -> str:
    """The page with its tables as the code has them."""
    for name, text in texts.items():
        begin, end = f"<!-- begin: doc/generate.py {name} -->", f"<!-- end: {name} -->"
        before, mark, rest = page.partition(begin)
        _, closing, after = rest.partition(end)
        if not mark or not closing:
            sys.exit(f"{file}: the marks {begin} and {end} are missing")
        page = f"{before}{begin}\n\n{text}\n\n{end}{after}"
    return page


def parameters() -> str:
    """A table for each section of the configuration, without those of effects."""
    sections: dict[str, list[Parameter]] = {}
    for name, parameter in parameter_table().items():
        if not name.startswith("effects.") or name == "effects.active":
            sections.setdefault(name.rpartition(".")[0], []).append(parameter)
    parts = []
    for section, entries in sections.items():
        rows = [
            f"| `{entry.name.rpartition('.')[2]}`{' *' if entry.runtime else ''} | {nominal(entry)} | {allowed(entry)} "
            f"| {entry.description} |"
            for entry in entries
        ]
        parts += [
            f"### `{section}`",
            "\n".join(["| key | nominal | allowed | meaning |", "| --- | --- | --- | --- |", *rows]),
        ]
    return "\n\n".join(parts)


def effects() -> str:
    """The catalogue, one row an effect."""
    rows = []
    for name, effect in CATALOGUE.items():
        keys = ", ".join(f"`{each.name}` {nominal(each)} ({allowed(each)})" for each in effect.parameters)
        text = " ".join((effect.__doc__ or "").partition("\n\n")[0].split())
        rows.append(f"| `{name}` | {PLACES[effect.place]} | {keys} | {text} |")
    head = ["| effect | place | parameters: nominal (range) | what it is |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *rows])


def tables() -> str:
    """The columns of the tables of an archive."""
    parts = []
    for name, columns in TABLES.items():
        rows = [f"| `{column}` | {kind} | {text} |" for column, kind, text in ((c, plain(k), t) for c, k, t in columns)]
        parts += [f"### `{name}.parquet`", "\n".join(["| column | type | what |", "| --- | --- | --- |", *rows])]
    return "\n\n".join(parts)


def plain(kind: Any) -> str:
    """A type of Arrow in words."""
    text = re.sub(r"list<element: (.*)>$", r"list of \1", str(kind))
    return re.sub(r"struct<(.*)>", lambda found: f"({found[1]})", text)


def nominal(parameter: Parameter) -> str:
    """Value and unit."""
    value = parameter.nominal
    values = value if isinstance(value, tuple) else (value,)
    text = ", ".join(map(shown, values)) or "none"
    return f"{text} {unit(parameter)}".strip()


def shown(value: Any) -> str:
    """One value as a parameter file has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value) or "`''`"


def allowed(parameter: Parameter) -> str:
    """What is allowed, in words."""
    text = re.sub(r"^(allowed|wanted): ", "", parameter.allowed()).replace("'", "`")
    return re.sub(r"\binf\b", "any", text)


def unit(parameter: Parameter) -> str:
    """Unit, empty for ratios and texts."""
    return "" if parameter.unit in ("", "1") else parameter.unit


PAGES = {"configuration.md": {"parameters": parameters, "effects": effects}, "archive.md": {"tables": tables}}

if __name__ == "__main__":
    main()
