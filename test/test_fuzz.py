# SPDX-License-Identifier: BSD-3-Clause
"""Untrusted input of all kinds: no exception that is not ours, no hang, no memory, no prediction out of bounds.

`make fuzz` runs this file for long: COMAN_FUZZ is which share of 10^5 messages, 10^4 bags, robot descriptions and
configurations it sends.
"""

from __future__ import annotations

import io
import os
import random
import resource
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from fuzz_tools import Fuzzed, with_other_bytes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from synthetic import description, write_bag
from synthetic import walk as synthetic_walk

from coman_reduced_model.bag.session import Session
from coman_reduced_model.core.config.files import load_config, save_config
from coman_reduced_model.core.config.schema import Config, config_from_flat, parameter_table
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.errors import ComanError

SHARE = float(os.environ.get("COMAN_FUZZ", "0"))
MEMORY = 2**30  # bytes beside what is loaded
pytestmark = pytest.mark.timeout(120 + 20_000 * SHARE)


def cases(few: int, many: int = 10_000) -> int:
    """How many cases a test sends: few, or in a long run a share of many."""
    return max(few, round(SHARE * many))


def examples(few: int):
    """A Hypothesis test of so many cases."""
    return settings(max_examples=cases(few), database=None, suppress_health_check=list(HealthCheck))


seeds = st.integers(0, 2**32 - 1).map(random.Random)


@pytest.fixture(autouse=True)
def bounded_memory(record_property):
    """Whatever a small file says, it takes no more than a gigabyte."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    record_property("memory_mb", more / 2**20)
    assert more < MEMORY


@pytest.fixture
def sent(record_property):
    """Counts what a test sends, for the page of results."""
    counts = Counter()
    yield counts
    for name, value in counts.items():
        record_property(name, value)


@pytest.mark.parametrize("reference", ["motor", "none"])
def test_messages_whose_values_contradict_physics(reference, sent):
    """Each message is used or counted, and no prediction is farther off than a robot can be."""
    fuzzed, seed, wanted = Fuzzed(reference), 0, cases(60, 50_000)
    while fuzzed.spoiled < wanted:
        fuzzed.run(random.Random(seed), 1500, share=(0.02, 0.2)[seed % 2])
        seed += 1
    sent.update(cases=fuzzed.spoiled, predictions=fuzzed.predictions, off_mm=round(1e3 * fuzzed.off))
    assert fuzzed.predictions > fuzzed.spoiled


def test_a_walk_that_is_not_spoiled_loses_nothing():
    fuzzed = Fuzzed()
    fuzzed.run(random.Random(1), 1500, share=0.0)
    assert fuzzed.predictions > 250 and fuzzed.spoiled == 0


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A short bag: its bytes, and those of its metadata."""
    path = write_bag(tmp_path_factory.mktemp("fuzz") / "bag", synthetic_walk(0.1))
    return next(path.glob("*.mcap")).read_bytes(), (path / "metadata.yaml").read_bytes()


def predicted(path: Path) -> None:
    """Go through a bag; what is wrong with it is said by an error of ours, or a warning."""
    try:
        with Session(path, Config().replaced({"prediction.horizons": []})) as session:
            for prediction in session.predictions():
                assert not np.linalg.norm(prediction.residual) >= 0.5
    except ComanError as error:
        assert str(error) and len(str(error)) < 2000


@pytest.mark.slow
@examples(60)
@given(rng=seeds)
def test_files_of_other_bytes(bag, tmp_path_factory, sent, rng):
    sent["cases"] += 1
    file, metadata = bag
    folder = tmp_path_factory.getbasetemp() / "fuzzed"
    folder.mkdir(exist_ok=True)
    whole = rng.random() < 0.5
    (folder / "bag.mcap").write_bytes(file if whole else with_other_bytes(file, rng))
    (folder / "metadata.yaml").write_bytes(with_other_bytes(metadata, rng) if whole else metadata)
    predicted(folder if rng.random() < 0.7 else folder / "bag.mcap")


TAGS = ("link", "joint", "inertial", "mass", "origin", "limit", "parent", "collision", "geometry", "box", "axis")
WORDS = ('""', '"nan"', '"-1"', '"1e300"', '"0 0"', '"l_sole"', '"x y z"', '"inf inf inf"', '"&#0;"', '"prismatic"')


@examples(60)
@given(rng=seeds)
def test_robot_descriptions_of_other_words(sent, rng):
    sent["cases"] += 1
    text = description()
    for _ in range(rng.choice((1, 2, 5))):
        parts = text.split('"')
        kind = rng.random()
        if kind < 0.6 and len(parts) > 3:
            place = 2 * rng.randrange(len(parts) // 2) + 1
            parts[place] = rng.choice(WORDS).strip('"')
            text = '"'.join(parts)
        elif kind < 0.8:
            text = text.replace(f"<{rng.choice(TAGS)} ", f"<{rng.choice(TAGS)} ", rng.randrange(1, 4))
        else:
            start = rng.randrange(len(text))
            text = text[:start] + text[start + rng.randrange(200) :]
    try:
        robot = Robot(text, Config().robot)
        robot.posture().update(np.zeros(len(robot.joint_names)), np.zeros(len(robot.joint_names)))
    except ComanError as error:
        assert "\n" not in str(error)


values = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.lists(st.floats(), max_size=7),
    st.lists(st.text(max_size=4), max_size=3), st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
    st.just(10**400), st.dates(),
)  # fmt: skip
keys = st.one_of(st.sampled_from(sorted(parameter_table())), st.text(max_size=6))


@examples(150)
@given(changes=st.dictionaries(keys, values, max_size=5))
def test_configurations_of_other_values(sent, changes):
    sent["cases"] += 1
    try:
        config = config_from_flat(changes, "file")
        config_from_flat(config.flat(), "again")
    except ComanError as error:
        assert str(error)


@examples(100)
@given(content=st.one_of(seeds, st.text(max_size=40), st.recursive(values, lambda e: st.dictionaries(st.text(), e))))
def test_configuration_files_of_other_bytes(tmp_path_factory, sent, content):
    sent["cases"] += 1
    path = tmp_path_factory.getbasetemp() / "config.yaml"
    if isinstance(content, random.Random):
        path.unlink(missing_ok=True)
        save_config(Config(), path)
        path.write_bytes(with_other_bytes(path.read_bytes(), content))
    elif isinstance(content, str):
        path.write_text(f"/**:\n  ros__parameters:\n    {content}", encoding="utf-8", errors="replace")
    else:
        stream = io.StringIO()
        yaml.safe_dump({"/**": {"ros__parameters": content}}, stream)
        path.write_text(stream.getvalue(), encoding="utf-8", errors="replace")
    try:
        load_config(path)
    except ComanError as error:
        assert str(error)
