# SPDX-License-Identifier: BSD-3-Clause
"""Files of nominal variability: read, written, refused in one line."""

from __future__ import annotations

import re

import pytest
import yaml
from conftest import ROOT

from coman_reduced_model.core.base.nominal import SECTIONS, load_nominal
from coman_reduced_model.errors import ConfigError
from coman_reduced_model.judge.learn import header


def test_the_shipped_population_is_whole():
    nominal = load_nominal()
    assert set(nominal.most) <= set(nominal.widths)
    assert all(value > 0.0 for value in nominal.widths.values())
    assert nominal.precise and set(nominal.precise) <= set(nominal.widths)
    for weights in nominal.decision.values():
        learnt = {"one", "evidence", "ways", "leftover", "apart", "pulled", "unknown", "alarm", "together"}
        assert learnt == set(weights)
    assert {"commit", "seeds", "cases", "widths"} <= set(nominal.source)
    assert nominal.interval_factor["all"] > 1.0 and all(value >= 1.0 for value in nominal.interval_factor.values())
    assert nominal.trust and all(law in nominal.leftover for law in nominal.trust)
    assert all(median > 0.0 and scatter > 0.0 for median, scatter in nominal.leftover.values())


def test_what_is_written_is_what_is_read(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(load_nominal().plain()))
    again = load_nominal(path)
    assert again.plain() == load_nominal().plain()
    assert again.width("com", "spread", times=2.0)["precise"] == pytest.approx(2.0 * again.precise["com.spread"])
    assert again.width("mass", "spread", times=2.0)["spread"] == pytest.approx(2.0 * again.widths["mass.spread"])


def test_weights_of_an_earlier_version_are_those_of_the_population(tmp_path):
    path, population = tmp_path / "mine.yaml", load_nominal()
    plain = population.plain() | {"interval_factor": 7.0}
    path.with_name("other.yaml").write_text(yaml.safe_dump(plain))
    assert load_nominal(path.with_name("other.yaml")).interval_factor == {"all": 7.0}
    plain["decision"] = dict.fromkeys(plain["decision"], {"one": -2.0, "train": 0.5, "select": 0.6, "unknown": -2.0})
    path.write_text(yaml.safe_dump(plain))
    again = load_nominal(path)
    assert again.decision == population.with_baseline["decision"]
    assert again.interval_factor == population.with_baseline["interval_factor"]


def test_weights_that_are_not_whole_are_those_of_the_population(tmp_path):
    path, population = tmp_path / "mine.yaml", load_nominal()
    path.write_text(yaml.safe_dump(population.plain() | {"decision": {"alone": {"evidence": 1.0}}}))
    assert load_nominal(path).decision == population.with_baseline["decision"]


def test_a_baseline_that_was_learnt_again_counts_at_once(tmp_path):
    path, plain = tmp_path / "mine.yaml", load_nominal().plain()
    for width in (0.001, 0.002):
        plain["widths"]["mass.spread"] = width
        path.write_text(yaml.safe_dump(plain))
        assert load_nominal(path).widths["mass.spread"] == width


def test_a_file_with_widths_in_newtons_is_refused(tmp_path):
    path, plain = tmp_path / "mine.yaml", load_nominal().plain()
    plain["widths"]["external_force.reach"] = 10.0
    path.write_text(yaml.safe_dump(plain))
    with pytest.raises(ConfigError, match="of an earlier version, .* learn it again"):
        load_nominal(path)


def test_widths_that_a_file_of_an_earlier_version_lacks_are_those_of_the_population(tmp_path):
    path, plain = tmp_path / "mine.yaml", load_nominal().plain()
    del plain["widths"]["touchdown_impact.impulse.spread"]
    plain["widths"]["mass.spread"] = 0.001
    path.write_text(yaml.safe_dump(plain))
    widths = load_nominal(path).widths
    assert widths["touchdown_impact.impulse.spread"] == load_nominal().widths["touchdown_impact.impulse.spread"]
    assert widths["mass.spread"] == 0.001


def test_noise_of_sensors_may_be_a_robots_own_and_else_is_that_of_the_population(tmp_path):
    path, population = tmp_path / "mine.yaml", load_nominal()
    plain = population.plain() | {"floor": {"force": 2.0}, "sensors": {"count": 0.001}, "limits": {"scuff": 0.02}}
    path.write_text(yaml.safe_dump(plain))
    mine = load_nominal(path)
    assert mine.floor == {**population.floor, "force": 2.0} and len(mine.floor) > 1
    assert mine.sensors == {**population.sensors, "count": 0.001} and len(mine.sensors) > 1
    assert mine.limits == {**population.limits, "scuff": 0.02} and len(mine.limits) > 1


def test_limits_are_those_that_the_code_reads_and_are_described():
    sources = [path.read_text() for path in (ROOT / "coman_reduced_model").rglob("*.py")]
    read = {name for text in sources for name in re.findall(r'limits\["(\w+)"\]', text)}
    assert read == set(load_nominal().limits) and all(value > 0.0 for value in load_nominal().limits.values())
    comment = (ROOT / "config/nominal.yaml").read_text().partition("\nsource:")[0]
    assert all(re.search(rf"\b{name}\b", comment) for name in read)
    assert comment + "\n" == header()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "with 'widths:'"),
        ("widths: [1, 2]", "with 'widths:'"),
        ("widths: {a.spread: wide}", "a value of a wrong kind"),
        ("widths: {a.spread: 1.0}\nfigures: {}", "figures: unknown"),
        ("widths: {a.spread: 1.0}\nleftover: {spring: 3}", "a value of a wrong kind"),
        ("widths: {a.spread: 1.0}\nmonitor: [1]", "a value of a wrong kind"),
        ("widths: {a.spread: 1.0}\nmonitor: {spring: }", "a value of a wrong kind"),
        ("widths: {a.spread: 1.0}\nmonitor: {spring: {single: 1.0}}", "without 'unit'"),
        ("widths: {a.spread: 1.0}\nmonitor: {spring: {unit: rad, single: 0.0}}", "single: 0.0"),
        ("widths: {a.spread: 1.0}\nmonitor: {spring: {unit: rad, usual: .nan}}", "usual: nan"),
        ("widths: {a.spread: 1.0}\ntrust: {spring|any: 0.0}", "trust of spring"),
        ("widths: {a.spread: 1.0}\ndecision: {alone: {alarm: 30}}", "alarm: 30"),
        ("widths: {a.spread: 1.0}\nwith_baseline: {decision: {alone: {alarm: -1}}}", "alarm: -1"),
        ("widths: {a.spread: 1.0}\ninterval_factor: {payload: .nan}", "interval_factor of payload"),
        ("widths: {a.spread: 1.0}\ntrust: {spring|any: 1.5}", "trust of spring"),
        ("widths: {a.spread: .nan}", "a.spread: nan"),
        ("widths: {a.spread: 1.0}\nparameters: {mass@root_joint: [.inf, 0.1]}", "mass@root_joint: inf"),
        ("widths: {a.spread: 1.0}\nparameters: {mass@root_joint: [0.1]}", "a value of a wrong kind"),
        ("widths: {a.spread: 1.0}\nleftover: {force/x: [1.0, .nan]}", "force/x: nan"),
        ("widths: {a.spread: 1.0}\nsource: [1]", "a value of a wrong kind"),
        ("widths: {a.spread: 1.0}\nlimits: {scuff: 0.0}", "limits: scuff: 0.0"),
        ("widths: {a.spread: 1.0}\nlimits: {scuf: 0.1}", "limits: scuf: unknown; known: experiment"),
        ("widths: {", "is not YAML"),
    ],
)
def test_nonsense_is_refused_in_one_line(text, reason, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=reason) as error:
        load_nominal(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    with pytest.raises(ConfigError, match="cannot be read"):
        load_nominal(tmp_path / "missing.yaml")


def test_every_section_is_known():
    assert set(SECTIONS) >= set(load_nominal().plain())
