# SPDX-License-Identifier: BSD-3-Clause
"""README and doc/ are true to the code: what they show is run, and what they name exists.

Each page is a session in an empty folder beside the checkout's bags and configurations: its fenced blocks run one after
the other, as a reader would type them. An HTML comment above a block says what is not run as it stands:

    <!-- not run: needs hardware -->          a reason of REASONS
    <!-- long, run as:                        these lines run instead; without `long`: with recordings that are there
    coman judge --out judged --seeds 0:1
    -->
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

import pytest
import typer
import yaml
from conftest import ROOT, child_environment

from coman_reduced_model.cli.main import app
from coman_reduced_model.core.config.schema import Config, config_from_flat
from coman_reduced_model.topics import INPUT_TOPICS, OUTPUT_TYPES

PAGES = [ROOT / "README.md", *sorted((ROOT / "doc").glob("*.md"))]
RESULTS = sorted((ROOT / "doc" / "results").glob("*.md"))
REASONS = ("needs hardware", "needs an installed ROS 2", "needs rerun-sdk", "needs the repository's history")
LANGUAGES = ("bash", "python", "yaml", "json", "text")
GIVEN = ("bags", "bench", "config", "doc", "launch", "test", "Makefile")  # of the checkout, in the folder of a session
STARTS_NODES = re.compile(r"^coman (demo|live|replay)\b", re.M)
_BLOCK = re.compile(
    r"(?:^ *<!-- (?P<mark>(?:not run|long|run as)[^>]*?) ?-->\n)?"
    r"^(?P<indent> *)```(?P<language>\w*)\n(?P<text>.*?)^(?P=indent)```$",
    re.M | re.S,
)
_GENERATED = re.compile(r"<!-- begin: .*?<!-- end", re.S)


@dataclass(frozen=True)
class Block:
    """A fenced block: `runs` is what the session does, empty if nothing."""

    page: str
    line: int
    language: str
    text: str
    mark: str
    runs: str


def blocks(page: Path) -> list[Block]:
    page_text = page.read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(page_text):
        mark, shown = match["mark"] or "", dedent(match["text"])
        runs = "" if mark.startswith("not run") else dedent(mark.partition("run as:\n")[2]) if mark else shown
        line = page_text[: match.start("text")].count("\n") + 1
        found.append(Block(page.name, line, match["language"], shown, mark, runs))
    return found


BLOCKS = {page.name: blocks(page) for page in PAGES}
TEXTS = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
ALL = "\n".join(TEXTS.values())
SHOWN = [
    re.sub(r"\\\n\s*", "", line)
    for found in BLOCKS.values()
    for block in found
    if block.language == "bash"
    for line in re.findall(r"^(?:\w+=\S+ )*(coman (?:.*\\\n)*.*)$", block.text + block.runs, re.M)
]
NAMED = re.findall(r"`(coman [^`\n]+)`", ALL)
COMMANDS = sorted({*SHOWN, *(line for line in NAMED if "--" in line)})


def session(page: str) -> list[pytest.Mark]:
    """A page that starts nodes is a test of ROS: these run one after the other."""
    nodes = any(STARTS_NODES.search(block.runs) for block in BLOCKS[page] if block.language == "bash")
    return [pytest.mark.slow, pytest.mark.timeout(1800), *([pytest.mark.ros] if nodes else [])]


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=session(page))
        for page, found in BLOCKS.items()
        if any(block.runs and block.language in ("bash", "python") for block in found)
    ],
)
def test_what_a_page_shows_runs(page, tmp_path):
    for name in GIVEN:
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / ".venv" / "bin").parent.mkdir()
    (tmp_path / ".venv" / "bin").symlink_to(Path(sys.executable).parent)
    environment = child_environment(PATH=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    for block in BLOCKS[page]:
        if not block.runs or block.language not in ("bash", "python"):
            continue
        if block.language == "bash":
            command = ["bash", "-euo", "pipefail", "-c", block.runs]
        else:
            (tmp_path / f"line_{block.line}.py").write_text(block.runs, encoding="utf-8")
            command = [sys.executable, f"line_{block.line}.py"]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            text=True,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=500,
        )
        assert done.returncode == 0, f"{page}, line {block.line}: {done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    for table, file in TABLES.get(page, {}).items():
        written = json.loads((tmp_path / file).read_text(encoding="utf-8"))
        assert rows(TEXTS[page], table) == {*written}, f"{page}: the table of {table} and {file}"


# Tables of keys: by page, the first cell of their head, and the file that a session writes.
TABLES = {
    "bags.md": {"`summary.json`": "result/summary.json"},
    "diagnosis.md": {"`diagnosis.json`": "found/diagnosis.json"},
}


def rows(text: str, head: str) -> set[str]:
    """The keys in the first column of the table that begins with a head."""
    (table,) = re.findall(rf"^\| {re.escape(head)} \|.*\n\| --- .*\n((?:\|.*\n)+)", text, re.M)
    return {key for line in table.splitlines() for key in re.findall(r"`(\w+)`", line.split("|")[1])}


def test_blocks_are_found():
    assert sum(map(len, BLOCKS.values())) > 20 and len(SHOWN) > 10


@pytest.mark.parametrize("page", BLOCKS)
def test_each_block_has_a_language_and_a_reason_if_it_is_not_run(page):
    assert TEXTS[page].count("```") == 2 * len(BLOCKS[page])
    for block in BLOCKS[page]:
        assert block.language in LANGUAGES, f"line {block.line}"
        if block.mark.startswith("not run"):
            assert block.mark.removeprefix("not run: ") in REASONS, f"line {block.line}"
        else:
            assert block.runs.strip() or block.language != "bash", f"line {block.line}"
    marks = re.findall(r"<!-- (?:not run|long|run as)", TEXTS[page])
    assert len(marks) == sum(bool(block.mark) for block in BLOCKS[page]), "a mark that no block follows"


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_are_understood(line):
    """Options and arguments are as the page says; nothing is run."""
    name, *arguments = shlex.split(line, comments=True)[1:]
    whole = typer.main.get_command(app)
    if name.startswith("--"):  # an option of coman itself: these act as soon as they are parsed
        assert name in {option for parameter in whole.params for option in parameter.opts} and not arguments
    else:
        whole.commands[name].make_context(name, arguments)


@pytest.mark.parametrize("page", BLOCKS)
def test_configurations_are_accepted(page):
    for block in BLOCKS[page]:
        if block.language == "yaml":
            config_from_flat(yaml.safe_load(block.text), f"{page}, line {block.line}")


def test_launch_files_nodes_and_scripts_exist():
    started = re.findall(r"^ros2 (?:launch|run) coman_reduced_model (\S+)", ALL, re.M)
    nodes = re.findall(r'f"(\w+) = ', (ROOT / "setup.py").read_text(encoding="utf-8"))
    assert len(started) > 2
    assert not [name for name in started if name not in nodes and not (ROOT / "launch" / name).exists()]
    listed = set(re.findall(r"`(\w+\.launch\.py)`", TEXTS["topics.md"]))
    assert listed == {path.name for path in (ROOT / "launch").glob("*.py")}


def test_make_targets_exist():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert set(re.findall(r"(?:^|`)make ([a-z][a-z-]+)", ALL, re.M)) <= {*targets}


def test_files_exist():
    names = set(re.findall(r"`?((?:bench|config|bags|test|doc|launch)/[\w/.]+\.(?:py|yaml|md|png|urdf))", ALL))
    assert len(names) > 10 and not [name for name in names if not (ROOT / name).exists()]


@pytest.mark.parametrize("page", [*PAGES, *RESULTS], ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[\w-]+)?\)", page.read_text(encoding="utf-8"))
    broken = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert not broken


@pytest.mark.parametrize("page", [*PAGES, *RESULTS], ids=lambda page: page.name)
def test_tables_are_whole(page):
    """Every row of a table has as many cells as its head: else it is cut off, or no table at all, where it is shown."""
    lines = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S).splitlines()
    cells = [len(re.sub(r"`[^`]*`", "", line).split("|")) if line.startswith("|") else 0 for line in lines]
    for i, line in enumerate(lines):
        if cells[i] and cells[i - 1]:
            assert cells[i] == cells[i - 1], line
        elif cells[i]:
            assert lines[i - 1] == "" or lines[i - 1].startswith("<!--"), line
            assert re.fullmatch(r"\|( --- \|)+", lines[i + 1]), line


def test_every_page_is_in_the_index():
    linked = set(re.findall(r"\]\((\w+\.md)\)", TEXTS["index.md"]))
    assert linked == {page.name for page in (ROOT / "doc").glob("*.md")} - {"index.md"}
    linked = set(re.findall(r"\]\(results/(\w+\.md)\)", TEXTS["results.md"]))
    assert linked == {page.name for page in RESULTS}


def test_parameters_exist():
    keys = {*Config().flat(), "model.yaml", "model.py"}  # the latter two are files
    sections = "prediction|model|streams|robot|support|output|monitor|gait|virtual_robot"
    named = set(re.findall(rf"`((?:{sections})\.[a-z_]+[12]?)", _GENERATED.sub("", ALL)))
    assert len(named) > 5 and not named - set(keys)


def test_every_topic_is_on_its_page():
    shown = set(re.findall(r"`([a-z_/]+)`", TEXTS["topics.md"]))
    assert {*INPUT_TOPICS.values(), *OUTPUT_TYPES} <= shown


def test_the_tables_of_the_configuration_are_those_of_the_code():
    subprocess.run([sys.executable, ROOT / "doc" / "generate.py", "--check"], check=True)


def test_the_readme_is_short():
    assert len(TEXTS["README.md"].splitlines()) <= 180


@pytest.mark.parametrize("page", RESULTS, ids=lambda page: page.name)
def test_results_say_what_they_were_measured_with(page):
    text = page.read_text(encoding="utf-8")
    assert re.search(r"^- version: [0-9a-f]{7}", text, re.M) and re.search(r"^- machine: \S", text, re.M)
    command = re.search(r"^(?:Generated|Measured) by `([^`]+)`", text, re.M)
    assert command and command[1].startswith(("python bench/", "coman "))


def test_the_table_of_the_readme_is_that_of_the_results():
    (block,) = re.findall(r"<!-- begin: bench/results.py free_run -->\n(.*?)\n<!-- end -->", TEXTS["README.md"], re.S)
    measured = [cells_of(line) for line in (ROOT / "doc/results/free_run.md").read_text().splitlines()]
    lines = block.splitlines()
    assert len(lines) > 4
    for line in lines[2:]:
        assert any(cells_of(line) <= cells for cells in measured), line


def cells_of(line: str) -> set[str]:
    return {cell.strip() for cell in line.strip().strip("|").split(" | ")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_words_are_those_of_the_glossary(page):
    text = _GENERATED.sub("", page.read_text(encoding="utf-8"))
    found = re.findall(r"\b(?:tell|tells|told|heard|anew|so many|fresh eyes|hair's breadth|healthy)\b", text, re.I)
    assert not found
