# SPDX-License-Identifier: BSD-3-Clause
"""What is hidden in the virtual robot has the size that the diagnosis gives it, with and without torque sensors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from coman_reduced_model.core.base.nominal import load_nominal
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.diagnose.data.reading import read_bags
from coman_reduced_model.diagnose.inference.case_cache import CaseCache
from coman_reduced_model.diagnose.inference.check import check_recordings
from coman_reduced_model.diagnose.inference.search import search
from coman_reduced_model.sim.disturbances import make
from coman_reduced_model.sim.record import record

# Name, where it is, what it has; the parameter that is compared, within a share of it.
HIDDEN: dict[str, tuple[str, str, dict[str, float], str, float]] = {
    "friction": ("joint_friction", "", {"coulomb": 1.0}, "coulomb", 0.06),
    "play": ("backlash", "", {"width": 0.006}, "width", 0.12),
    "damping": ("joint_damping", "", {"scale": 2.0}, "scale", 0.06),
    "slips": ("hysteresis", "RKneeSag", {"width": 0.006, "friction": 0.5}, "width", 0.1),
    "gain": ("wrench_scale", "left", {"scale": 1.4}, "scale", 0.02),
}
SIZES = [*((name, ()) for name in HIDDEN), ("friction", ("tau",)), ("damping", ("tau",))]


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """A walk with something hidden; each recorded once."""
    known: dict[str, Path] = {}

    def call(name: str):
        if name not in known:
            effect, where, values, *_ = HIDDEN[name]
            known[name] = tmp_path_factory.mktemp("sizes") / name
            hidden = make(effect, {**values, "where": where})
            record("test2", known[name], disturbances=[hidden], seed=11, duration_s=10.0)
        return known[name]

    return call


@pytest.mark.slow
@pytest.mark.parametrize(("name", "lacks"), SIZES, ids=["-".join([name, *lacks]) for name, lacks in SIZES])
def test_what_is_hidden_comes_back_at_its_size(walks, name, lacks):
    effect, where, values, key, share = HIDDEN[name]
    config = load_config(None)
    (reading,) = read_bags([walks(name)], config, None, None, lambda done, what: None)
    reading = replace(reading, recording=reading.recording.changed(**dict.fromkeys(lacks)))
    checked = check_recordings([reading], 1, config, [(effect, where)])
    found = search(CaseCache(checked.train, [], load_nominal()), [(effect, where)])
    sizes = {found.known[i].key: found.known[i].value(found.fit.x[i]) for i in found.released}
    assert sizes[key] == pytest.approx(values[key], rel=2.0 * share if lacks else share)
