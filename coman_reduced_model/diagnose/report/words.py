# SPDX-License-Identifier: BSD-3-Clause
"""The result of a diagnosis in words: sentences, places, channels, figures with their units."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

from ...core.effects.catalogue import CATALOGUE
from ...core.effects.unknown import LINKS, PLAN
from ..inference.weight import Weight

Parameters = Mapping[str, Mapping[str, Any]]

CHANNELS = {
    "spring": "spring law",
    "torque": "joint torque",
    "force": "force balance",
    "moment": "moment balance",
    "feet": "sole against sole",
    "slide": "sole after landing",
    "tilt": "trunk's tilt",
    "plan": "motors against plan",
    "landing": "force at landing",
    "unloaded": "sensor in the air",
    "com": "COM, free run",
}
# What a unit is shown as: name and factor.
_SHOWN = {"rad": ("degrees", 180.0 / math.pi), "m": ("mm", 1e3), "s": ("ms", 1e3), "1": ("%", 100.0)}
_MEANING = {
    "none": "By all laws together, what the nominal robot leaves unexplained is no more than nominal robots leave, "
    "whose springs, masses and sensors scatter by some percent. An effect smaller than the limits below can still be "
    "there.",
    "doubtful": "More is left unexplained than most nominal robots leave, but some leave as much: it is no alarm. The "
    "probabilities say what it might be.",
    "unknown": "Something is missing: that nothing is, is too improbable, or what the robot weighs, or all that varies "
    "on it together, is further off than on nominal robots. No effect of the catalogue, nor a group that these "
    "recordings cannot distinguish, is as likely as all else that may be missing. The model was left as it is. The "
    "residuals below show where to look.",
    "contradicted": "An effect would explain the recordings that it was found in, but not the one that confirms. The "
    "model was left as it is.",
    "minor": "What was found is there, but hardly any of the error of the predicted COM, or of the residuals that "
    "depend on it, goes back to it.",
    "not_excited": "Nothing was found, but it means little: both feet must leave the ground in turn before "
    "most effects can show. "
    "Record a walk of ten seconds or more, better two of different gaits.",
}
FAR_HEAD = ("what varies", "where", "value", "standard deviations")
EXPLAINED = {"com": "the error of the predicted COM", "residuals": "the residuals that depend on it"}
ASKEW = 1.5  # times as far as one end of an interval, that a value is from the other, from which both are said
LIKELY, MOST_LIKELY = 0.1, 3  # probability from which a sentence names what is not sure, and how many
OUTSIDE = "something outside the catalogue"
TOGETHER = "masses, zeros, gains and all else that varies would have to be off together as on hardly any nominal robot"


def sentence(result: Mapping[str, Any]) -> str:
    """The verdict for a person, after clocks that are apart, and whether the robot weighs what its URDF says."""
    text = _verdict(result)
    if apart := result["clocks_apart"]:
        more = f" (and {len(apart) - 1} more)" if len(apart) > 1 else ""
        text = f"check the clocks first: {apart[0]}{more}; beside that, {text}"
    off = off_weight(result["weight"])
    return f"{text}; {off}" if off else text


def off_weight(weight: Mapping[str, float]) -> str:
    """That the robot does not weigh what its URDF says; "" where it does, as far as data sheets allow, or may do."""
    share = weight["share"]
    if not Weight(**weight).off:
        return ""
    return f"by its forces, the robot weighs {abs(share):.0%} {'more' if share > 0.0 else 'less'} than by its URDF"


def _verdict(result: Mapping[str, Any]) -> str:
    worst = next((channel(key.partition("|")[0]) for key in result["too_much"]), "")
    most = next((stands_out(key, times) for key, times in result["apart"].items()), "")
    most = most or (f"more is left in the {worst}, than on nominal robots" if worst else "")
    likely = _likely(result["probabilities"])
    denied = " and ".join(spaced(name) for name in result["contradicted"])
    against = f"; the confirming recording speaks against {denied}" if denied else ""
    unexplained = f"; but {most}, unexplained" if most else ""
    if result["verdict"] == "none" and not result["only_minor"]:
        text = "nothing is missing that this data could show"
        if doubtful(result):
            text = "no alarm, as some nominal robots look like this too; but perhaps something is missing"
            text += f": {likely}" if likely else ""
            text += against
        return text + unexplained
    if result["verdict"] == "not_excited":
        return "nothing was found, but this recording only stands: most effects could not show"
    if result["verdict"] == "unknown":
        if denied:
            return f"something is missing; {denied} would explain it, but the confirming recording speaks against it"
        if result["pulled_too_far"]:
            return f"something is missing: {TOGETHER}" + (f"; perhaps {likely}" if likely else "")
        if result["probabilities"].get("unknown", 0.0) < 0.5 and (likely or off_weight(result["weight"])):
            return "something is missing, but it is not clear what" + (f": {likely}" if likely else "")
        return "something is missing that no effect of the catalogue explains" + (f": {most}" if most else "")
    text = "; ".join(effect_sentence(effect, result["only_minor"]) for effect in result["effects"])
    if not result["probabilities"]:  # nothing was compared
        text = f"assumed: {text}{against}"
    if result["only_minor"]:
        text = f"no effect that matters to the prediction was found; minor: {text}{against}{unexplained}"
    return text


def meaning(result: Mapping[str, Any]) -> str:
    """What a verdict means that names nothing, or nothing that matters."""
    verdict = str(result["verdict"])
    if verdict == "unknown" and result["contradicted"]:
        verdict = "contradicted"
    if result["only_minor"]:
        verdict = "minor"
    return _MEANING.get("doubtful" if verdict == "none" and doubtful(result) else verdict, "")


def doubtful(result: Mapping[str, Any]) -> bool:
    """Whether something is more likely to be missing than nothing, alarm or not."""
    return float(result["probabilities"].get("none", 1.0)) < 0.5


def _likely(found: Mapping[str, float]) -> str:
    """What is likely to be missing by the first comparison, the most probable first; nothing: an empty text."""
    names: Counter[str] = Counter()
    for name, probability in found.items():
        if name != "none":
            names[OUTSIDE if name == "unknown" else spaced(name)] += probability  # type: ignore[assignment]
    order = [(name, p) for name, p in names.most_common(MOST_LIKELY) if p >= LIKELY]
    return " or ".join(f"{name} ({p:.0%})" for name, p in order)


def stands_out(key: str, times: float) -> str:
    """Of a joint that is apart from the others of its robot."""
    return f"{times:.1f} times as much is left in the {channel(key.partition('|')[0])}, as in the middle joint"


def effect_sentence(effect: Mapping[str, Any], said_minor: bool = False) -> str:
    """One effect with its values and their intervals (1.96 standard deviations).

    Args:
        said_minor: whether what goes before it says that it is minor.
    """
    text = _said(effect)
    if effect.get("left_out"):
        text += f" (not in the model: {effect['left_out']})"
    elif effect.get("minor"):
        share, of = effect["explains"]["share"], EXPLAINED[effect["explains"]["of"]]
        text += f" ({'' if said_minor else 'minor: '}it explains {max(share, 0.0):.0%} of {of})"
    text += or_else(effect)
    if effect["class"] and effect["class"] not in map(_class, _others(effect)):
        text += (
            f", or another effect of the class {spaced(effect['class'])}, which this data cannot distinguish from it"
        )
    return text


def or_else(effect: Mapping[str, Any]) -> str:
    """The rest of the group of an effect, with the group's probability, to follow its sentence; "" if it is alone."""
    if not (others := alternatives(effect)):
        return ""
    return (
        f", or {' or '.join(others)}, which these recordings cannot distinguish (together {effect['probability']:.0%})"
    )


def alternatives(effect: Mapping[str, Any]) -> list[str]:
    """The others of the group of an effect, each with its place, in words."""
    return [named(*each) for each in _others(effect)]


def _others(effect: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Names and places of the others of its group, each once."""
    parts = (name.partition("@") for name in effect.get("group", ()))
    places = [(name, at(where)) for name, _, where in parts]
    return [each for each in dict.fromkeys(places) if each != (effect["name"], effect["where"])]


def _class(each: tuple[str, str]) -> str:
    kind = CATALOGUE.get(each[0])
    return kind.ambiguity.name if kind and kind.ambiguity else ""


def named(name: str, where: str) -> str:
    """An effect and its place, such as `foot slip of the left foot`."""
    kind = CATALOGUE.get(name)
    if not where and (kind is None or kind.place not in ("foot", "joint")):
        return spaced(name)
    return f"{spaced(name)} of {place(where, kind is not None and kind.place == 'foot')}"


def _said(effect: Mapping[str, Any]) -> str:
    """One effect in the words of the catalogue; if it has none for these parameters, they are listed."""
    name, parameters = effect["name"], effect["parameters"]
    kind = CATALOGUE.get(name)
    at = place(effect["where"], kind is not None and kind.place == "foot")
    values = {key: figure(parameter) for key, parameter in parameters.items()}
    sizes = {f"{key}_size": figure(_size(each)) for key, each in parameters.items()}
    listed = _listed(values)
    wanted = {"at"} if kind is None else set(re.findall(r"{(\w+)}", kind.sentence))
    if kind is None or not wanted <= {"at", "listed", *values, *sizes}:
        return f"{spaced(name)} at {at} ({listed})"
    first = kind.parameters[0]
    below = kind.opposite and not parameters[first.name]["value"] > first.nominal
    text = (kind.opposite if below else kind.sentence).format(at=at, listed=listed, **values, **sizes)
    rest = {key: each for key, each in values.items() if not wanted & {key, f"{key}_size", "listed"}}
    return text + kind.further.format(rest=_listed(rest), **values) if rest else text


def _size(parameter: Mapping[str, Any]) -> Mapping[str, Any]:
    """The same without its sign."""
    if parameter["value"] >= 0.0:
        return parameter
    low, high = parameter["interval"]
    return {**parameter, "value": -parameter["value"], "interval": [-high, -low]}


def _listed(values: Mapping[str, str]) -> str:
    return ", ".join(f"{key} {text}" for key, text in values.items())


def figure(parameter: Mapping[str, Any]) -> str:
    """A value with half its interval, in the units of a reader; with both ends, where it is not in the middle."""
    unit, factor = _SHOWN.get(parameter["unit"], (parameter["unit"], 1.0))
    value, low, high = (factor * x for x in (parameter["value"], *sorted(parameter["interval"])))
    if max(high - value, value - low) > ASKEW * min(high - value, value - low):
        shown = (f"{x:.0f}" if 1e3 <= abs(x) < 1e5 else f"{x:.3g}" for x in (value, low, high))
        return "{} ({} to {}) {}".format(*shown, unit)
    return f"{number(value, 0.5 * (high - low))} {unit}"


def number(value: float, half: float) -> str:
    """`value ± half` with two digits of the latter, but no more than three of the value."""
    if not (math.isfinite(half) and half > 0.0) or not 1e-3 < max(abs(value), half) < 1e5:
        return f"{value:.3g} ± {half:.2g}" if half > 0.0 else f"{value:.3g}"
    fine, coarse = (digits - math.floor(math.log10(size)) for digits, size in ((1, half), (2, max(abs(value), half))))
    decimals = max(0, min(fine, coarse))
    return f"{value:.{decimals}f} ± {half:.{decimals}f}"


def far(row: Mapping[str, Any]) -> list[str]:
    """What is far from nominal: of what, where, its value, and how far [standard deviations]."""
    words = dict.fromkeys([*row["name"].split("_"), *row["parameter"].split("_")])
    name = " ".join(word for word in words if word)
    return [name, at(row["where"]) or "–", figure(row), f"{row['deviations']:.1f}"]


def shown(value: float, unit: str) -> str:
    """A size in the units of a reader."""
    name, factor = _SHOWN.get(unit, (unit, 1.0))
    size = factor * value
    return f"{size:.0f} {name}" if 100.0 <= abs(size) < 1e5 else f"{size:.2g} {name}"


def figures_of(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Values of unknowns of an effect in their units, without intervals."""
    return ", ".join(f"{key} {shown(value, units[key])}" for key, value in values.items())


def place(where: str, foot: bool = False) -> str:
    """Where an effect sits: `LKneeSag` is "the left knee (LKneeSag)"; names that say nothing stay as they are."""
    if where in ("left", "right"):
        return f"the {where} foot" if foot else f"all joints of the {where} leg"
    if not where:
        return "both feet" if foot else "all joints"
    side = re.search("left|right", where, re.I) or re.match(
        r"[LlRr](?=_|LEG_|leg_|[A-Z][a-z]|(?i:knee|hip|ank))", where
    )
    part = re.search(r"knee|ank|hip", where, re.I)
    if not side or not part:
        return where
    axis = re.search(r"(pitch|sag)|(roll|lat)|(yaw)", where, re.I)
    turn = "" if part[0].lower() == "knee" or not axis else (" pitch", " roll", " yaw")[axis.lastindex - 1]  # type: ignore[operator]
    joint = {"ank": "ankle"}.get(part[0].lower(), part[0].lower())
    return f"the {'left' if side[0].lower().startswith('l') else 'right'} {joint}{turn} ({where})"


def channel(name: str) -> str:
    """`spring/LKneeSag` in words."""
    kind, _, rest = name.partition("/")
    return f"{CHANNELS.get(kind, kind)}, {rest.replace('/', ' ')}" if rest else CHANNELS.get(kind, kind)


def channel_unit(name: str) -> tuple[str, float]:
    """What a channel is shown in, and the factor to it from SI units."""
    kind, _, rest = name.partition("/")
    last = rest.rpartition("/")[2]
    if kind in ("spring", "tilt") or last in ("roll", "pitch", "yaw"):
        return "°", _SHOWN["rad"][1]
    if kind in ("plan", "com", "feet", "slide"):
        return _SHOWN["m"]
    if kind == "landing":
        return "Ns", 1.0
    newton = kind == "force" or (kind == "unloaded" and last.startswith("f"))
    return ("N", 1.0) if newton else ("Nm", 1.0)


def spaced(name: str) -> str:
    """A name of the vocabulary in words; `NAME@PLACE` with its place as it is."""
    effect, _, where = name.partition("@")
    return effect.replace("_", " ") + (f" of {at(where)}" if at(where) else "")


def at(where: str) -> str:
    """The place of a candidate; "" for a second way of an effect to show itself, which is no place."""
    return "" if where in (PLAN, LINKS) else where


def known(value: float | None, form: str = ".0f") -> str:
    """A number, whole unless `form` is another format, or a dash where it is not known."""
    return "–" if value is None or not math.isfinite(value) else format(value, form)
