# SPDX-License-Identifier: BSD-3-Clause
"""Pages that hold the result of a run of the judge."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import calibration
from markdown import honest_line, trimmed, write_into_readme

ROOT = Path(__file__).resolve().parent.parent


def judged(title: str, file: str, show: str, folder: str = "") -> Callable[[Path], tuple[str, str]]:
    """A page of what `coman judge` says of a finished run: JUDGED, or a folder in it."""

    def page(shared: Path) -> tuple[str, str]:
        from coman_reduced_model.cli import judge_tables

        run_folder = Path(os.environ.get("JUDGED", "judged")) / folder
        if not (run_folder / file).is_file():
            sys.exit(f"{run_folder / file}: not there: run coman judge first (JUDGED is its folder)")
        found = json.loads((run_folder / file).read_text(encoding="utf-8"))
        begun = run_folder / "commit.txt"
        at = f"Judged at commit {begun.read_text().strip()}.\n\n" if begun.is_file() else ""
        os.environ["COLUMNS"] = "150"
        if file == "score.json" and not folder:
            write_into_readme(ROOT / "README.md", "judge", honest_line(found))
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            getattr(judge_tables, show)(found, Path("judged") / folder)
        text = f"{at}```text\n{trimmed(printed.getvalue())}\n```"
        if "calibration" in found and not folder:
            calibration.draw(found["calibration"], ROOT / "doc" / "results" / "judge.png")
            text += f"\n\n![{calibration.CAPTION}](judge.png)"
        return title, text

    return page


def left_out(shared: Path) -> tuple[str, str]:
    """A page of what judge/learn.py writes beside the file that it learns; LEFT_OUT names it."""
    from coman_reduced_model.cli.judge_tables import show_left_out

    path = Path(os.environ.get("LEFT_OUT", "nominal.left_out.json"))
    if not path.is_file():
        sys.exit(f"{path}: not there: run judge/learn.py first (LEFT_OUT is the file that it writes)")
    os.environ["COLUMNS"] = "150"
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        show_left_out(json.loads(path.read_text(encoding="utf-8")), Path(path.name))
    return "Kinds of worlds left out", (
        "The weights by which an effect is named, learnt again without each kind of world in turn, and judged on the "
        "cases of that kind. What a case is compared by (widths, trust, what laws leave) was learnt on half of all "
        "cases, without it; the alarm is that of the other kinds.\n\n"
        f"```text\n{trimmed(printed.getvalue())}\n```"
    )
