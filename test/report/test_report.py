# SPDX-License-Identifier: BSD-3-Clause
"""The report: one page without outside help, numbers as in the summary, honest whatever came out."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from coman_reduced_model.bag.types import bag_types
from coman_reduced_model.bag.writer import BagWriter
from coman_reduced_model.core.base.types import Flags, Foot, Phase, Prediction, SupportState
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.evaluation.run import run_of
from coman_reduced_model.core.evaluation.statistics import AXES, RunStatistics
from coman_reduced_model.errors import BagError
from coman_reduced_model.messages import COM_PREDICTION, prediction_to
from coman_reduced_model.output import to_json
from coman_reduced_model.report.draw import draw, thin
from coman_reduced_model.report.figures import NoData, heat_map, spectrum, three_steps
from coman_reduced_model.report.prediction import prediction_page, write_report
from coman_reduced_model.report.verdict import millimetres, sentence

NAN3 = np.full(3, np.nan)
DT = 0.01
CYCLE = ((Phase.DOUBLE, Foot.LEFT), (Phase.LEFT, Foot.LEFT), (Phase.DOUBLE, Foot.RIGHT), (Phase.RIGHT, Foot.RIGHT))


def walk(stretches=9, length=50, error=(0.006, 0.0, 0.001)):
    """Predictions of a walk: the COM sags by 3 mm in x and 4 mm in z; the model is off by `error` [m]."""
    predictions = []
    for i in range(stretches * length):
        phase, foot = CYCLE[(i // length) % 4]
        T = np.eye(4)
        T[:3, 3] = 0.03 * (i // (2 * length)), 0.07 if foot == Foot.LEFT else -0.07, 0.0
        reference = np.array((0.0003 * (i % length), 0.01 * np.sin(0.03 * i), 0.35))
        measured = reference - (0.003, 0.0004, 0.004)
        zero = np.zeros(3)
        predictions.append(
            Prediction(
                10**9 + round(i * DT * 1e9),
                "l_sole" if foot == Foot.LEFT else "r_sole",
                SupportState(phase, foot, {Phase.LEFT: 1.0, Phase.RIGHT: 0.0}.get(phase, 0.5), 0.0, 170.0),
                measured,
                zero,
                reference,
                zero,
                measured - error,
                zero,
                T,
                [],
                Flags.RESET if i == 0 else Flags.OK,
            )
        )
    return predictions


def summary_of(predictions, **changes):
    """The summary that `coman predict` makes of them, as it is read back."""
    statistics = RunStatistics(0.25)
    for prediction in predictions:
        statistics.add(prediction)
    errors = {"published": 1e-3, "model": 1.5e-3, "planned": 3e-3, "persistence": 2e-3, "lipm": float("nan")}
    summary = {
        "bag": "bags/test1",
        "robot": {"name": "coman", "mass_kg": 17.3},
        **statistics.summary(),
        "skill": {"0.1": dict.fromkeys(AXES, 0.5)},
        "horizon_rmse_m": {"0.1": {name: dict.fromkeys(AXES, value) for name, value in errors.items()}},
        "rejected": {"joint_states/nan": 3},
        "last_rejection": {"joint_states/nan": "position of LKneeSag is NaN"},
        "warnings": ["left_foot/wrench: wrong sign?"],
        "config": Config().flat(),
        "realtime_factor": 21.0,
        **changes,
    }
    return json.loads(to_json(summary))


def without(predictions, *names, flags=Flags.OK):
    """The same predictions, some of their vectors unknown."""
    return [replace(p, **dict.fromkeys(names, NAN3), flags=flags) for p in predictions]


def write(folder, predictions, summary=None):
    with BagWriter(folder / "predictions", {"/robot/com/prediction": COM_PREDICTION}) as writer:
        for p in predictions:
            writer.write("/robot/com/prediction", p.stamp_ns, prediction_to(bag_types(), p))
    (folder / "summary.json").write_text(to_json(summary or summary_of(predictions)), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write(tmp_path_factory.mktemp("out"), walk())
    write_report(folder)
    return folder


@pytest.fixture(scope="module")
def html(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def diverged(predictions):
    """The same predictions, twenty of them far away: finite, and not."""
    far = [replace(p, predicted_com=p.predicted_com + 10.0 ** (8 * k)) for k, p in enumerate(predictions[200:220])]
    far[3].predicted_com[:] = np.inf
    return [*predictions[:200], *far, *predictions[220:]]


def text_of(html):
    return re.sub(r"<[^>]*>", " ", re.sub(r"<style>.*?</style>", "", html, flags=re.S))


@pytest.mark.slow
def test_page_needs_nothing_from_elsewhere(html):
    assert "http:" not in html and "https:" not in html and "@import" not in html
    assert not re.search(r"<(script|link|iframe|img|object)\b|\bsrc=", html)
    assert set(re.findall(r"url\((.)", html)) <= {"#"}
    assert set(re.findall(r'href="(.)', html)) == {"#"}


def test_links_within_the_page_lead_somewhere_and_ids_are_unique(html):
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    targets = set(re.findall(r'href="#([^"]+)"', html)) | set(re.findall(r"url\(#([^)]+)\)", html))
    assert targets <= set(ids)


def test_figures_are_well_formed_described_and_saved_as_png(folder, html):
    drawings = re.findall(r"<svg .*?</svg>", html, flags=re.S)
    for drawing in drawings:
        ElementTree.fromstring(drawing)
    alts = re.findall(r'role="img" aria-label="([^"]*)"', html)
    assert len(drawings) == len(alts) == 8 and all(len(alt) > 20 for alt in alts)
    assert len(list((folder / "plots").glob("*.png"))) == len(drawings)


def test_sentence_and_table_have_the_numbers_of_the_summary(folder, html):
    summary = json.loads((folder / "summary.json").read_text())
    lead = re.search(r"<h1>(.*?)</h1>", html, flags=re.S)[1]
    assert "z is predicted to 1.00 mm RMS where a rigid robot is 4.00 mm off" in lead
    assert "x is not explained: 6.00 mm RMS where a rigid robot is only 3.00 mm off" in lead
    table = text_of(html[html.index("<table") : html.index("</table>")])
    for kind in ("rmse_m", "rmse_rigid_m"):
        for axis in AXES:
            assert millimetres(summary[kind][axis]).removesuffix(" mm") in table
    for phase in ("left support", "right support", "double support"):
        assert phase in table


def test_warnings_and_rejections_are_told(html):
    assert "left_foot/wrench: wrong sign?" in html
    assert "position of LKneeSag is NaN" in html


@pytest.mark.slow
def test_page_is_made_again_over_an_old_one_and_small(folder):
    path = write_report(folder)
    assert path == folder / "report.html" and path.stat().st_size < 3e6
    assert not list(folder.glob("*.part"))


@pytest.mark.slow
def test_page_of_a_minute_stays_small_whatever_the_noise():
    rng = np.random.default_rng(1)
    predictions = [replace(p, measured_com=p.measured_com + rng.normal(0, 1e-4, 3)) for p in walk(120)]
    assert len(prediction_page(summary_of(predictions), run_of(predictions))) < 3e6


errors = st.floats(1e-6, 1.0)


@given(errors, errors)
def test_sentence_says_worse_when_it_is_worse(error, rigid):
    by = {"samples": 10, "judged_samples": 10, "rmse_m": {"x": error}, "rmse_rigid_m": {"x": rigid}}
    said = sentence(by)
    assert ("x is not explained" in said) == (error > 1.1 * rigid)
    assert ("x is predicted to" in said) == (error <= 0.5 * rigid)
    assert millimetres(error) in said
    assert "y is not known" in said


def test_sentence_without_a_rigid_robot_to_compare_with():
    said = sentence(summary_of(without(walk(), "reference_com")))
    assert "without a reference there is no rigid robot" in said
    assert "0.1 s ahead the COM is predicted in x to 1.00 mm (+0.50)" in said and "nan" not in said


def test_sentence_tells_how_much_it_covers():
    predictions = walk()
    part = without(predictions[:45], "predicted_com", flags=Flags.STALE_WRENCH) + predictions[45:]
    assert "This covers 90 % of the samples." in sentence(summary_of(part))


DEGENERATE = {
    "no samples": ([], "Nothing was predicted: the recording gave no usable sample"),
    "one sample": (walk(1, 1), "holds no 3 steps"),
    "no reference": (
        without(walk(), "reference_com", "predicted_com", flags=Flags.NO_REFERENCE | Flags.NOT_INITIALISED),
        "Nothing was predicted in 450 samples: the configured reference is missing",
    ),
    "nothing known": (
        [
            replace(p, support=SupportState(), T_odom_sole=np.full((4, 4), np.nan))
            for p in without(walk(), "measured_com", "reference_com", "predicted_com", flags=Flags.NO_SUPPORT)
        ],
        "No wrenches: the load on the feet is not known",
    ),
    "standing": (walk(1, 500), "holds no 3 steps in a row (it has 0 complete steps)"),
    "no free run": (without(walk(), "predicted_com"), "Nothing was predicted in 450 samples"),
    "perfect": (walk(error=(0.0, 0.0, 0.0)), "x is predicted to 0.00 mm RMS"),
    "stamps go back": (walk()[200:] + walk()[:200], "Errors"),
    "beyond physics": (
        diverged(walk()),
        "In 20 samples (4.44 %) the predicted COM is more than 0.5 m from the measured one, which is beyond physics",
    ),
    "a reference beyond physics": (
        [replace(p, reference_com=p.reference_com + (0, 0, 5e8)) for p in walk()],
        "In 450 samples (100 %) the reference COM is more than 0.5 m from the measured one",
    ),
    "restarts": (
        [replace(p, flags=Flags.RESET | Flags.REJECTED_STATE) for p in walk()[:45]] + walk()[45:],
        "In 45 samples (10 %) the free run diverged",
    ),
    "predictions ahead that simpler ones took over": (
        [replace(p, flags=Flags.SIMPLER_AHEAD) for p in walk()[:90]] + walk()[90:],
        "In 20 % of the samples a baseline had been better than the model on some axis.",
    ),
    "predictions ahead beyond physics": (
        [replace(p, flags=Flags.REJECTED_STATE) for p in walk()[:45]] + walk()[45:],
        "In 45 samples (10 %) a prediction ahead was beyond physics",
    ),
}


@pytest.mark.slow
@pytest.mark.timeout(300, method="thread")  # dashes of a line that leaves the figure by 1e200 m are drawn for hours
def test_a_run_that_diverged_is_drawn_in_seconds(tmp_path):
    page = write_report(write(tmp_path, diverged(walk())))
    assert "beyond physics: the figures leave it out" in page.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("case", DEGENERATE)
@pytest.mark.filterwarnings("error")
def test_whatever_comes_out_there_is_a_page_that_says_so(case):
    predictions, wanted = DEGENERATE[case]
    html = prediction_page(summary_of(predictions), run_of(predictions))
    assert wanted in html
    assert not re.search(r"\bnan\b", text_of(html).replace("joint_states/nan", ""))


def test_texts_of_the_recording_are_not_markup():
    predictions = walk(1, 3)
    html = prediction_page(summary_of(predictions, robot={"name": "<b>&"}, bag="a/<script>"), run_of(predictions))
    assert "<b>" not in html and "<script>" not in html and "&lt;b&gt;&amp;" in html


def test_summary_of_another_version_lacks_things():
    predictions = walk(1, 3)
    html = prediction_page({"samples": 3, "rmse_m": {}}, run_of(predictions))
    assert "Nothing was predicted in 3 samples" in html and "does not hold the configuration" in html


def test_folder_without_results_is_refused_in_one_line(tmp_path):
    def refused(pattern):
        with pytest.raises(BagError, match=pattern) as caught:
            write_report(tmp_path / "out")
        assert "\n" not in str(caught.value)

    refused("out: no such folder")
    (tmp_path / "out").mkdir()
    refused("no summary.json in it")
    summary = tmp_path / "out" / "summary.json"
    summary.write_bytes(b"\xff{")
    refused("is not JSON")
    summary.write_text("{\n]")
    refused("is not JSON")
    summary.write_text('{"verdict": "none"}')
    refused("not a summary of coman predict")
    summary.write_text('{"samples": 3, "rmse_m": {}}')
    refused("no predictions/")
    (tmp_path / "out" / "predictions").mkdir()
    refused("not a bag")


def test_a_spectrum_is_that_of_the_longest_stretch_without_a_pause():
    """A clock that is set forward by half a century fills no memory."""
    run = run_of(walk(17))
    later = replace(run, time=run.time + np.where(np.arange(len(run)) < 1000, 0.0, 1.7e9))
    assert spectrum(later) is not None
    broken = replace(run, time=run.time + 10.0 * (np.arange(len(run)) // 200))
    with pytest.raises(NoData, match="4 s without a pause"):
        spectrum(broken)


def test_three_steps_are_in_the_middle_and_follow_each_other():
    run = run_of(walk(17))
    first, last = run.consecutive_steps(3)
    steps = [step for step in run.steps() if first <= step.first < last]
    assert [step.foot for step in steps] in ([Foot.LEFT, Foot.RIGHT, Foot.LEFT], [Foot.RIGHT, Foot.LEFT, Foot.RIGHT])
    assert abs((first + last) / 2 - len(run) / 2) < 100
    with pytest.raises(NoData, match="it has 2 complete steps"):
        three_steps(run_of(walk(5)))


@given(
    arrays(float, st.integers(1, 400), elements=st.floats(-1e3, 1e3) | st.just(np.nan)),
    st.integers(1, 20),
    st.data(),
)
def test_a_thinned_line_keeps_its_extremes_and_its_gaps(y, points, data):
    breaks = data.draw(arrays(bool, len(y)))
    x = np.arange(float(len(y)))
    thin_x, thin_y = thin(x, y, breaks, points)
    known = np.isfinite(y)
    assert set(zip(thin_x[np.isfinite(thin_y)], thin_y[np.isfinite(thin_y)], strict=True)) <= set(
        zip(x, y, strict=True)
    )
    if known.any():
        assert np.nanmax(thin_y) == np.nanmax(y) and np.nanmin(thin_y) == np.nanmin(y)
    for a, b in zip(range(len(thin_x)), range(1, len(thin_x)), strict=False):
        if np.isfinite(thin_y[a]) and np.isfinite(thin_y[b]):  # joined on paper: joined in the data
            between = slice(int(thin_x[a]) + 1, int(thin_x[b]) + 1)
            assert known[between].all() and not breaks[between].any()


def test_parts_for_other_reports():
    figure = heat_map(np.array(((1.0, np.nan), (3.0, 4.0))), ("x", "z"), ("left", "right"), "excess [1]")
    assert "n/a" in draw("heat", figure, "where it disagrees").svg
    with pytest.raises(NoData):
        heat_map(np.full((1, 2), np.nan), ("x",), ("left", "right"), "excess [1]")


def test_a_live_run_shows_the_skill_that_the_node_told(tmp_path):
    predictions = walk(3)
    summary = summary_of(predictions, horizon_rmse_m={}, skill={"0.2": {"x": 0.25, "y": -0.5, "z": None}})
    page = write_report(write(tmp_path, predictions, summary)).read_text()
    assert "0.2 s" in page and "+0.25" in page and "-0.50" in page and "No horizon prediction" not in page


@pytest.mark.slow
def test_the_first_thing_on_the_page_is_a_figure_and_warnings_come_before_it():
    predictions = walk()
    html = prediction_page(summary_of(predictions, warnings=["left_foot/wrench: reversed"]), run_of(predictions))
    body = html[html.index("</header>") :]
    assert body.index("left_foot/wrench: reversed") < body.index("<figure") < body.index("<table")


def test_on_a_phone_each_number_of_a_wide_table_has_its_name_beside_it():
    predictions = walk()
    html = prediction_page(summary_of(predictions), run_of(predictions))
    assert "@media screen and (max-width: 44rem)" in html and "min-width: 40rem" not in html  # figures shrink
    lists = re.findall(r'<table class="list">.*?</table>', html, re.S)
    assert len(lists) > 1
    for table in lists:
        labels = re.findall(r'<td[^>]* data-label="([^"]*)"', table)
        assert labels and all(labels) and len(labels) == table.count("<td") - table.count("<td colspan")
    assert 'data-label="x, forward [mm], predicted"' in html
