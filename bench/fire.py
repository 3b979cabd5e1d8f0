# SPDX-License-Identifier: BSD-3-Clause
"""Pages of the long tests, `make fuzz` and `make soak`: what they sent, and what came of it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from xml.etree import ElementTree

from markdown import table

ROOT = Path(__file__).resolve().parent.parent
# Test, what it sends, and the bound that it holds beside those of all.
FUZZED = {
    "test_messages_whose_values_contradict_physics[motor]": "messages of a walk, default model",
    "test_messages_whose_values_contradict_physics[none]": "messages of a walk, no motor side",
    "test_files_of_other_bytes": "bags: MCAP files and metadata",
    "test_robot_descriptions_of_other_words": "robot descriptions",
    "test_configurations_of_other_values": "configurations: values",
    "test_configuration_files_of_other_bytes": "configurations: files",
}


def fuzz(shared: Path) -> tuple[str, str]:
    """The page of `make fuzz`; COMAN_FUZZ is which share of the full number of cases."""
    os.environ.setdefault("COMAN_FUZZ", "1")
    found = tested("test/test_fuzz.py", "-n", os.environ.get("JOBS", "2"))
    rows = [
        [f"{what} (`{test}`)", number(of["cases"]), f"{float(of['seconds']):.0f}", f"{float(of['memory_mb']):.0f}"]
        for test, what in FUZZED.items()
        if (of := found.get(test))
    ]
    share = float(os.environ["COMAN_FUZZ"])
    length = "at full length" if share == 1.0 else f"at {share:g} of its full length"
    predictions = sum(int(of.get("predictions", 0)) for of in found.values())
    off = max((float(of.get("off_mm", 0)) for of in found.values()), default=0.0)
    return "Untrusted input", "\n\n".join([
        f"`test/test_fuzz.py` {length} (`make fuzz`). Each case ends in a result or in an error of the project's own "
        "with one line; a message is used or counted as rejected.",
        table(["what is spoiled", "cases", "time [s]", "more memory [MB]"], rows),
        f"Among and after the spoiled messages, {number(predictions)} predictions were made. The free run and the "
        f"predictions ahead were at most {off / 1e3:.2f} m from the measured COM.",
    ])  # fmt: skip


def soak(shared: Path) -> tuple[str, str]:
    """The page of `make soak`; COMAN_SOAK is its length [s]."""
    os.environ.setdefault("COMAN_SOAK", "3600")
    (of,) = tested("test/ros/test_soak.py").values()
    seconds, messages = int(of["seconds_long"]), int(of["messages"])
    rows = [
        [what, *(f"{value:.3g}" for value in (*thirds(of[name]), max(map(float, of[name].split()))))]
        for what, name in (
            ("resident memory [MB]", "memory_mb"),
            ("latency, median [ms]", "p50_ms"),
            ("latency, 99th percentile [ms]", "p99_ms"),
        )
    ]
    return "Nodes under fire", "\n\n".join([
        f"`test/ros/test_soak.py` for {seconds / 60:.0f} minutes (`make soak`). A predictor lives from the beginning "
        f"to the end. {of['segments']} times, another predictor and a listener were started and killed (SIGKILL), and "
        "the participant that publishes left and came back. Streams were cut, delayed by up to 0.4 s, sent twice, out "
        "of order and in bursts; clocks jumped by -10 s and +10 s every lap of 12 s.",
        f"{messages:,} messages were sent, {messages / seconds:,.0f} a second on average (as they come from a robot "
        "whose five streams have 1 kHz, less where the machine is busy: the sender waits for the nodes). "
        f"{int(of['compared']):,} predictions of the node that lived on and {int(of['killed_compared']):,} of those "
        "that were killed are, all of them, those that the pipeline makes of the same messages offline, to 1e-9 in "
        "every number.",
        f"Every message was counted: {int(of['rejected']):,} as rejected ({of['reasons']}), {int(of['late']):,} as "
        "late, the others as used.",
        "Of the node that lived on; latency is from the arrival of a message in the node to its prediction:",
        table(["", "first third, median", "last third, median", "largest"], rows),
    ])  # fmt: skip


def thirds(numbers: str) -> tuple[float, float]:
    """Medians of the first and of the last third."""
    values = [float(each) for each in numbers.split()]
    count = max(1, len(values) // 3)
    return median(values[:count]), median(values[-count:])


def number(text: object) -> str:
    return f"{int(str(text)):,}"


def tested(*arguments: str) -> dict[str, Mapping[str, str]]:
    """What tests have recorded by `record_property`, by test; a failure ends the program."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "junit.xml"
        clean = {key: text for key, text in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
        command = [sys.executable, "-m", "pytest", "-q", "-s", f"--junitxml={path}", *arguments]
        code = subprocess.run(command, cwd=ROOT, env=clean).returncode
        if code:
            sys.exit(code)
        cases = ElementTree.parse(path).getroot().iter("testcase")
        return {
            case.get("name", ""): {
                "seconds": case.get("time", "0"),
                **{each.get("name", ""): each.get("value", "") for each in case.iter("property")},
            }
            for case in cases
        }
