# SPDX-License-Identifier: BSD-3-Clause
"""The page of a diagnosis: what is missing, how it shows, how sure that is, and what is still open."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import LINKS, PLAN
from ...report.figures import heat_map
from ...report.page import Notice, Part, Section, Table, Text, page, picture
from ..inference.explanation import law_of
from ..inference.finding import Finding
from ..inference.finding import judged as is_judged
from ..inference.search import MOST
from ..result import Diagnosis
from .alike import decides, groups, taken_for
from .figures import Pair, com_error, law, pairs, residuals
from .tables import ROWS, errors_of_com, probabilities, values
from .words import (
    channel,
    channel_unit,
    effect_sentence,
    known,
    meaning,
    place,
    shown,
    spaced,
    stands_out,
)

_TIE = 0.5  # share of the best candidate's evidence from which another explains nearly as much
_HEADINGS = {
    "effect": "What is missing",
    "minor": "Nothing that matters to the prediction",
    "none": "No alarm",
    "unknown": "Something is missing, but it is not clear what",
    "not_excited": "This recording cannot decide",
}
_NOT_IN_MODEL = (
    "What the laws show of an effect stands, also where the model does without it. If it makes the predicted COM "
    "worse, its form in the model is not quite what happens on this robot, or it made up for something else that is "
    "off, such as a spring."
)


def diagnosis_page(diagnosis: Diagnosis) -> str:
    """One self-contained HTML page."""
    result = diagnosis.result
    train, hold = pairs(diagnosis.finding)
    words = str(result["sentence"])
    sections = [
        Section("Before and after" if diagnosis.finding.chosen else "How it shows", _shows(diagnosis, train, hold)),
        Section(_HEADINGS["minor" if result["only_minor"] else result["verdict"]], _verdict(result)),
        Section("Where it disagrees", _where(diagnosis)),
        Section("The gap", _gap(result)),
        Section("Other explanations", _ranking(diagnosis)),
        Section("What is still open", _open(diagnosis)),
    ]
    return page(f"Diagnosis of {_bags(result)}", words[:1].upper() + words[1:] + ".", sections, _facts(diagnosis))


def _bags(result: dict[str, Any]) -> str:
    return ", ".join(path.rstrip("/").rpartition("/")[2] for path in result["bags"]["train"])


def _facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    result = diagnosis.result
    count, held = len(result["bags"]["train"]), len(result["bags"]["holdout"])
    facts = [("verdict", spaced(result["verdict"])), ("robot", diagnosis.finding.train[0].state.world.robot.model.name)]
    facts.append(("recordings", f"{count} to find it in, {held} held out"))
    if any(effect["in_model"] for effect in result["effects"]):
        facts.append(("model with it", result["model"]))
    return [*facts, ("took", f"{result['seconds']:.0f} s")]


def _verdict(result: dict[str, Any]) -> list[Part]:
    parts: list[Part] = []
    if text := meaning(result):
        parts.append(Text(text))
    effects = result["effects"] or result["suspected"]
    if result["suspected"]:
        parts.append(Text("These effects were looked at as explanations, and are not sure enough:"))
    if effects:
        parts += [values(effects), errors_of_com(effects, bool(result["gap"]["holdout"]))]
    parts += probabilities(result)
    if result["effects"]:
        inside = [spaced(effect["name"]) for effect in effects if effect["in_model"]]
        parts.append(
            Text(
                f"{result['model']} beside this page is the configuration with "
                f"{' and '.join(inside) or 'none of this'}: commands and nodes run it as it is."
            )
        )
        if len(inside) < len(effects):
            parts.append(Text(_NOT_IN_MODEL))
    return parts


def _shows(diagnosis: Diagnosis, train: list[Pair], hold: list[Pair]) -> list[Part]:
    finding, result = diagnosis.finding, diagnosis.result
    changed = bool(finding.chosen)
    pair = (hold or train)[-1]
    which = "a held-out" if result["bags"]["holdout"] else "the last part of a training"
    seen = f"{which} recording, to which no value of an effect was fitted" if hold else "a training recording"
    parts: list[Part] = []
    for number, effect in enumerate(finding.chosen):
        name, where = effect.option.effect, effect.option.where
        most = _strongest(pair, list(effect.option.unknowns))
        if bent := CATALOGUE[name].law:
            joints = [c.partition("/")[2] for c in most if c.startswith(bent[0] + "/")]
            joint = where if where in pair.before.state.world.robot.joint_names else next(iter(joints), "")
            if joint:
                parts.append(
                    picture(
                        f"law{number}",
                        partial(law, [*train, *hold], name, joint),
                        f"Residual of {joint} before and after {spaced(name)}",
                        f"All recordings, {place(joint)}: what its nominal law does not explain. Nominal scatter is "
                        "taken off; black is what the effects alone make of it.",
                    )
                )
        parts.append(
            picture(
                f"residual{number}",
                partial(residuals, pair, most[:3], True),
                f"Residuals over time before and after {spaced(name)}",
                f"Where {spaced(name)} shows most, in {pair.name} ({seen}): measured minus what the robot should do, "
                "before and after. No values at changes of contact, where rigid bodies explain nothing.",
            )
        )
    worst = [key.split("|")[0] for key in result["too_much"]] or (
        [] if changed else [entry["channel"] for entry in result["localisation"]]
    )
    worst = list(dict.fromkeys(worst))[:3]
    if worst:
        parts.append(
            picture(
                "worst",
                lambda: residuals(_worst(train, hold, worst[0]), worst, changed),
                "The largest residuals over time",
                "The largest of what is left: measured minus what the robot should do.",
            )
        )
    parts.append(
        picture(
            "com",
            lambda: com_error(pair.name, diagnosis.com, changed),
            "Error of the predicted COM over time",
            f"Measured minus predicted COM of the free run, {pair.name}, with the nominal model"
            + (" and with all that was found in it." if changed else "."),
        )
    )
    return parts


def _strongest(pair: Pair, figures: list[int]) -> list[str]:
    """Channels that these figures change most, of those that are smaller for it, in units of the noise floor."""
    made: dict[str, float] = {}
    assert pair.finding.fit is not None
    (before, after), x = pair.left, pair.finding.fit.x[figures]
    for key, columns in pair.before.problem.columns.items():
        level, name = pair.before.floor.get(key, 0.0), key.partition("|")[0]
        if level > 0.0 and key in after:
            share = float(np.mean((columns[:, figures] @ x) ** 2)) / level**2
            less = float(np.mean(after[key] ** 2)) < float(np.mean(before[key] ** 2))
            made[name] = made.get(name, 0.0) + (share if less else 0.0)
    largest = max(made.values(), default=0.0)
    return [name for name, value in sorted(made.items(), key=lambda item: -item[1]) if value > 0.05 * largest]


def _worst(train: list[Pair], hold: list[Pair], name: str) -> Pair:
    """The recording with most left of a channel."""
    cases = [pair.after for pair in [*train, *hold]]
    judged = [pair for pair in [*train, *hold] if is_judged(cases, pair.after, name)]
    return max(judged, key=lambda pair: float(np.nanmean(np.append(pair.over_ticks(name)[1] ** 2, 0.0))))


def _where(diagnosis: Diagnosis) -> list[Part]:
    result = diagnosis.result
    entries = result["localisation"]
    if not entries:
        return [Notice("No residual could be computed: there is nothing to compare.")]
    phases = ("left", "right", "double")
    worst: dict[str, dict[str, float]] = {}
    for entry in entries:
        by = worst.setdefault(entry["channel"], {})
        by[entry["phase"]] = max(by.get(entry["phase"], 0.0), entry["excess"])
    names = list(worst)[:ROWS]  # the largest first
    sizes = np.array([[worst[name].get(phase, np.nan) for phase in phases] for name in names])
    first = entries[0]
    support = "double support" if first["phase"] == "double" else f"support by the {first['phase']} foot"
    pace = "steadily through a phase" if first["band_hz"][0] == 0.0 else "with the motion inside a phase"
    laws = [
        [f"{channel(name)} [{unit}]", *(f"{factor * entry[key]:.3g}" for key in ("mean", "rms", "floor"))]
        for name, entry in result["laws"].items()
        for unit, factor in [channel_unit(name)]
    ]
    return [
        Text(
            f"The nominal robot disagrees most in {channel(first['channel'])}, in {support}, {pace}: "
            f"{first['excess']:.1f} times the noise floor."
        ),
        picture(
            "where",
            lambda: heat_map(
                sizes,
                [channel(n) for n in names],
                ["left support", "right support", "double support"],
                "times the noise floor",
            ),
            "Heat map of the disagreement by channel and support phase",
            "RMS of what the nominal robot leaves on the training bags, its springs, masses and sensors free "
            "to scatter as those "
            "of nominal robots do, in units of the sensors' own noise.",
        ),
        Table(
            ["law", "mean", "RMS", "noise floor"],
            laws,
            "Force, moment and tilt are along the heading: x level and between the forward axes of both soles, z up.",
            folded="The plain laws: measured minus nominal, nothing fitted",
        ),
    ]  # fmt: skip


def _gap(result: dict[str, Any]) -> list[Part]:
    held = result["gap"]["holdout"]
    gap = held or result["gap"]["train"]
    before, after, level = gap["before"], gap["after"], gap["floor"]
    names = sorted(before, key=lambda n: -(before[n] - after.get(n, before[n])) / max(level.get(n, 0.0), 1e-12))
    com = [name for name in names if name.startswith("com/")]
    names = [*com, *(name for name in names if name not in com)]
    head = ["channel", "before", "after", "noise floor", "change"]
    rows = []
    for name in names:
        unit, factor = channel_unit(name)
        value, other, floor = (factor * which.get(name, np.nan) for which in (before, after, level))
        change = f"{100.0 * (other / value - 1.0):+.0f} %" if value > 0.0 and np.isfinite(other) else "–"
        rows.append([f"{channel(name)} [{unit}]", f"{value:.3g}", f"{other:.3g}", f"{floor:.3g}", change])
    which = "held-out recordings" if held else "training recordings: none was held out"
    caption = (
        f"RMS over the {which}. COM: error of the free run, after: with the effects that do not make it worse. The "
        "others: residuals, less nominal scatter as it fits each recording best."
    )
    if held:
        caption += (
            " No value of an effect was fitted to the held-out recordings. The last one confirms: it was opened once, "
            "at the end. Those before it helped to choose, and the COM of all decides what goes into the model."
        )
    parts: list[Part] = [Table(head, rows[:ROWS], caption, strong=range(len(com)))]
    if rows[ROWS:]:
        parts.append(Table(head, rows[ROWS:], folded=f"{len(rows) - ROWS} more channels"))
    return parts


def _ranking(diagnosis: Diagnosis) -> list[Part]:
    result = diagnosis.result
    named = {(effect["name"], effect["where"]) for effect in result["effects"]}
    head = ["effect", "where", "evidence [nats]", "held-out [nats]"]
    rows = [
        [spaced(entry["name"]), entry["where"] or "–", f"{entry['evidence']:.1f}", known(entry["holdout_gain"])]
        for entry in result["ranking"]
    ]
    strong = [i for i, entry in enumerate(result["ranking"]) if (entry["name"], entry["where"]) in named]
    caption = (
        "What each candidate alone adds to the nominal robot, before anything was chosen. After each choice "
        "the others are "
        f"looked at again (at most {MOST} are chosen), so that a second effect may stand far down here."
    )
    if not named:  # else the table of the effects has said it
        caption += " Evidence: natural logarithm of a ratio of probabilities (4.6 nats are 100 to 1)."
    parts: list[Part] = [Table(head, rows[:ROWS], caption, words=2, strong=[i for i in strong if i < ROWS])]
    if rows[ROWS:]:
        parts.append(Table(head, rows[ROWS:], words=2, folded=f"{len(rows) - ROWS} more candidates"))
    return parts


def _open(diagnosis: Diagnosis) -> list[Part]:
    finding, result = diagnosis.finding, diagnosis.result
    parts: list[Part] = []
    for effect in result["effects"]:
        name, rivals = effect["name"], _rivals(diagnosis, effect)
        text = f"{effect_sentence(effect)}."
        if rivals:
            text += f" Explaining nearly as much when alone: {', '.join(rivals)}."
        elif not (effect["class"] or effect["taken_for"] or len(effect["group"]) > 1):
            text += " No other effect, or place, explains half as much."
        text += taken_for(effect)
        if rivals or effect["class"]:
            text += f" What would decide: {CATALOGUE[name].experiment}."
        parts.append(Notice(text[:1].upper() + text[1:], "warn" if effect["class"] else "info"))
    parts += [Notice(decides(each)) for each in result["decides"]]
    parts += groups(result)
    for name in result["contradicted"]:
        parts.append(Notice(f"The confirming recording speaks against {spaced(name)}.", "warn"))
    if result["too_much"]:
        rows = [
            [channel(key.split("|")[0]), f"{result['leftover'][key]:.1f}", f"{_usual(finding, key):.1f}"]
            for key in result["too_much"][:ROWS]
        ]
        caption = "In units of the noise floor, the middle recording."
        parts.append(Table(["left unexplained", "left", "nominal robots"], rows, caption))
    out = [stands_out(key, times) for key, times in result["apart"].items()]
    parts += [Notice(line[:1].upper() + line[1:] + ".", "warn") for line in (*out, *result["not_checked"])]
    units = {(figure.effect, figure.key): figure.unit for figure in finding.known}
    rows = [
        [spaced(name), ", ".join(f"{spaced(key)} {shown(size, units[name, key])}" for key, size in sizes.items())]
        for name, sizes in sorted(result["undetectable_below"].items())
    ]
    caption = "The deviation from nominal that would just raise an alarm here, at the place where it shows best."
    if rows:
        parts.append(
            Table(["effect", "could hide below"], rows, caption, words=2, folded="What could still hide in the noise")
        )
    return parts


def _usual(finding: Finding, key: str) -> float:
    """What the law of a group leaves on nominal robots, in the median [noise floors]."""
    return finding.nominal.leftover.get(law_of(key), (float("nan"), 0.0))[0]


def _rivals(diagnosis: Diagnosis, effect: dict[str, Any]) -> list[str]:
    """Other effects and places that explain nearly as much as an effect when each is alone."""
    first = diagnosis.finding.first
    mine = [s for s in first if s.option.effect == effect["name"] and s.option.where in (effect["where"], PLAN, LINKS)]
    if not mine:
        return []
    found = [
        f"{spaced(score.option.effect)}" + (f" of {score.option.place}" if score.option.place else "")
        for score in first
        if score.physical
        and score.gain > _TIE * mine[0].gain
        and (score.option.effect, score.option.place) != (effect["name"], mine[0].option.place)
    ]
    return list(dict.fromkeys(found))[:4]
