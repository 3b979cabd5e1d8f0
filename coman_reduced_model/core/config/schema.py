# SPDX-License-Identifier: BSD-3-Clause
"""The configuration: one table of parameters, read from a ROS 2 parameter file by nodes and command line alike.

The dataclasses below *are* the table: each field carries its nominal, unit, bounds and description. Its dotted
name (`support.contact_on`) is the ROS parameter name. Effects bring their own parameters, which appear as
`effects.<effect>.where` and `effects.<effect>.<parameter>`.
"""

from __future__ import annotations

import dataclasses
import difflib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from ...errors import ConfigError, OutputError
from ...output import check_file
from ...resources import config_path
from ..base.parameter import Parameter, Value, par
from ..effects.base import EffectConfig
from ..effects.catalogue import CATALOGUE
from ..robot.configuration import RobotConfig

# What the paper's point mass lacks on any robot with springs, by the ablation of `coman validate`.
STANDARD_EFFECTS = ("gravity_stiffness", "trunk_rotation", "swing_momentum", "lateral_compliance")
STANDARD, NOTHING = "standard", "none"  # as entries of effects.active


@dataclass(frozen=True)
class StreamsConfig:
    """How the streams are joined by stamp."""

    max_wait: float = par(0.05, "s", "longest that a joint state waits (in stamps) for the other streams", 0.0, 2.0)
    max_wrench_age: float = par(0.05, "s", "a wrench farther than this from the joint state is stale", 1e-4, 2.0)
    max_motor_age: float = par(0.05, "s", "the same for the motor states", 1e-4, 2.0)
    max_reference_age: float = par(0.1, "s", "the same for com/reference", 1e-4, 5.0)
    restart_gap: float = par(
        0.25, "s", "a gap in the joint states longer than this restarts the prediction", 0.01, 60.0
    )
    velocity_window: float = par(0.04, "s", "window of the differentiation when velocities are missing", 0.002, 0.5)


@dataclass(frozen=True)
class SupportConfig:
    """Support phase from the foot wrenches: a Schmitt trigger a foot.

    The thresholds lie just above what an unloaded foot reads (noise of 1 %, a drifting zero and the inertia of the
    swinging foot, 2 % each), for a foot that peels off or settles carries 5 to 10 % for up to 0.1 s.
    """

    contact_on: float = par(0.07, "1", "share of the weight above which a foot lands", 0.01, 0.9, runtime=True)
    contact_off: float = par(0.04, "1", "share of the weight below which a foot lifts", 0.0, 0.9, runtime=True)
    dwell_on: float = par(0.002, "s", "a landing must last this long to count", 0.0, 0.5, runtime=True)
    dwell_off: float = par(0.007, "s", "a lift must last this long to count", 0.0, 0.5, runtime=True)
    share_hysteresis: float = par(
        0.10,
        "1",
        "in double support the support foot changes when the other carries this much more",
        0.0,
        0.9,
        runtime=True,
    )
    weight: float = par(0.0, "N", "weight for the thresholds; 0: mass of the URDF times gravity", 0.0, 1e5)


@dataclass(frozen=True)
class ModelConfig:
    """The paper's model and the choices in it (model.md; numbers in brackets are the paper's equations).

    None of it counts where `trunk_rotation` replaces that model.
    """

    stiffness: str = par(
        "full", "", "linear block of K_c (full) or trunk free to turn (condensed)", choices=("full", "condensed")
    )
    double_support: str = par(
        "scaled",
        "",
        "force of the support leg over its share (22), (23), or both legs in parallel",
        choices=("scaled", "both_legs"),
    )
    shares: str = par(
        "constant", "", "shares of (22), (23): the constants below or measured", choices=("constant", "measured")
    )
    share_x_before: float = par(
        0.42, "1", "x share of the leg in the double support before its single support", 0.05, 1.0
    )
    share_x_after: float = par(
        0.58, "1", "x share of the leg in the double support after its single support", 0.05, 1.0
    )
    share_z_before: float = par(0.42, "1", "z share before its single support (Fig. 9)", 0.05, 1.0)
    share_z_after: float = par(0.58, "1", "z share after its single support (Fig. 9)", 0.05, 1.0)
    a1: float = par(1.0, "1", "coefficient of k_xx in (20)", 0.0, 20.0)
    b1: float = par(1.0, "1", "coefficient of d_xx in (20)", 0.0, 50.0)
    c1: float = par(1.0, "1", "coefficient of k_xz in (20)", -20.0, 20.0)
    e1: float = par(1.0, "1", "coefficient of d_xz in (20)", -50.0, 50.0)
    a2: float = par(1.0, "1", "coefficient of k_zz in (21)", 0.0, 20.0)
    b2: float = par(1.0, "1", "coefficient of d_zz in (21)", 0.0, 50.0)
    c2: float = par(1.0, "1", "coefficient of k_zx in (21)", -20.0, 20.0)
    e2: float = par(1.0, "1", "coefficient of d_zx in (21)", -50.0, 50.0)
    singular_limit: float = par(
        0.02, "1", "smallest singular value of the leg Jacobian (scaled by leg length) taken as it is", 1e-6, 0.5
    )


@dataclass(frozen=True)
class PredictionConfig:
    """What is predicted and from which reference (model.md 5 and 6)."""

    reference: str = par(
        "motor", "", "motor-side kinematics, com/reference, or none (LIPM)", choices=("motor", "topic", "none")
    )
    reset_every_steps: int = par(
        1, "steps", "free run restarts from the measurement every so many steps; 0: never", 0, 1000
    )
    horizons: tuple[float, ...] = par(
        (0.1, 0.2, 0.4), "s", "horizons of the prediction from the measured state", 0.005, 2.0
    )


@dataclass(frozen=True)
class OutputConfig:
    """What the predictor node publishes besides com/prediction."""

    points_rate: float = par(
        50.0, "Hz", "rate of the PointStamped topics and of com/support when unchanged; 0: off", 0.0, 2000.0
    )
    markers_rate: float = par(20.0, "Hz", "rate of com/markers; 0: off", 0.0, 200.0)
    diagnostics_rate: float = par(1.0, "Hz", "rate of /diagnostics", 0.1, 20.0)


@dataclass(frozen=True)
class MonitorConfig:
    """Watching whether the robot still is what it was, and what its description says (core/monitor/monitor.py)."""

    enabled: bool = par(True, "", "watch laws of mechanics for mismatches: /diagnostics, warnings of summary.json")
    threshold: float = par(6.0, "1", "standard deviations that make a mismatch, of the weaker of two strides", 1.0, 1e3)


@dataclass(frozen=True)
class GaitConfig:
    """The walk that the trajectory node plans; names and bounds as in core/gait/gait.py."""

    name: str = par("test1", "", "named gait whose figures the values below replace")
    step_length: float = par(-2.0, "m", "advance of one step; -2: that of the named gait", -2.0, 1.0)
    single_support: float = par(-1.0, "s", "duration of single support; -1: that of the named gait", -1.0, 10.0)
    double_support: float = par(-1.0, "s", "duration of double support; -1: that of the named gait", -1.0, 10.0)
    steps: int = par(-1, "steps", "number of steps; -1: that of the named gait", -1, 100000)
    step_width: float = par(-1.0, "m", "distance of the soles in y; -1: that of the named gait", -1.0, 1.0)
    com_height: float = par(-1.0, "m", "height of the COM above the soles; -1: that of the named gait", -1.0, 3.0)
    zmp_offset_x: float = par(-1.0, "m", "ZMP ahead of the sole origin; -1: that of the named gait", -1.0, 0.5)
    rate: float = par(200.0, "Hz", "rate of com/reference", 1.0, 1000.0)
    preview_interval: float = par(0.02, "s", "spacing of the preview", 0.001, 0.5)
    preview_length: int = par(25, "points", "number of preview points", 0, 500)
    autostart: bool = par(True, "", "start walking at once, without a call of ~/start")
    repeat: bool = par(False, "", "start the plan again when it ends")
    start_time: float = par(-1.0, "s", "ROS time at which the plan starts, as in a bag; -1: at once", -1.0, 1e11)

    def changes(self) -> dict[str, Any]:
        """The parameters of core/gait/gait.py that replace those of the named gait."""
        given = {
            "step_length_m": self.step_length,
            "single_support_s": self.single_support,
            "double_support_s": self.double_support,
            "steps": self.steps,
            "step_width_m": self.step_width,
            "com_height_m": self.com_height,
            "zmp_offset_x_m": self.zmp_offset_x,
        }
        # One metre backwards is a step that can be asked for; for the others -1 makes no sense.
        return {key: value for key, value in given.items() if value != (-2.0 if key == "step_length_m" else -1)}


@dataclass(frozen=True)
class VirtualRobotConfig:
    """The virtual robot as a node; the predictor takes nothing from here."""

    rate: float = par(200.0, "Hz", "rate of its sensors", 50.0, 1000.0)
    seed: int = par(1, "", "of its sensor noise", 0, 2**31 - 1)
    noise: bool = par(True, "", "sensors with noise, bias, jitter and lost messages; false: perfect ones")


def nominal_effects(names: Sequence[str]) -> tuple[EffectConfig, ...]:
    """Effects at their only place, the robot, with nominal values."""
    return tuple(
        EffectConfig(name, "", {p.name: float(p.nominal) for p in CATALOGUE[name].parameters})  # type: ignore[arg-type]
        for name in names
    )


@dataclass(frozen=True)
class Config:
    """Everything a robot and its predictor are configured by. Immutable; `replaced` gives a changed copy."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    streams: StreamsConfig = field(default_factory=StreamsConfig)
    support: SupportConfig = field(default_factory=SupportConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    prediction: PredictionConfig = field(default_factory=PredictionConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    monitor: MonitorConfig = field(default_factory=MonitorConfig)
    gait: GaitConfig = field(default_factory=GaitConfig)
    virtual_robot: VirtualRobotConfig = field(default_factory=VirtualRobotConfig)
    effects: tuple[EffectConfig, ...] = field(default_factory=lambda: nominal_effects(STANDARD_EFFECTS))
    standard: bool = True  # the standard effects are among them if they can act: nobody named them one by one
    directory: Path = Path()  # of the file it came from: relative paths in it start there

    @property
    def active(self) -> tuple[str, ...]:
        """`effects.active` as it was given, not what it means."""
        names = tuple(dict.fromkeys(effect.name for effect in self.effects))
        if not self.standard:
            return names
        if not takes_standard(self):
            return (STANDARD, *names)
        others = tuple(name for name in names if name not in STANDARD_EFFECTS)
        return (STANDARD, *others) if len(names) - len(others) == len(STANDARD_EFFECTS) else names

    @property
    def turning(self) -> bool:
        """Whether `trunk_rotation` replaces the paper's model."""
        return any(effect.name == "trunk_rotation" for effect in self.effects)

    def flat(self) -> dict[str, Value]:
        """All values by dotted name, effects included."""
        values = dict(_flatten(self))
        names: dict[str, list[EffectConfig]] = {}
        for effect in self.effects:
            names.setdefault(effect.name, []).append(effect)
        values["effects.active"] = tuple(names)
        for name, instances in names.items():
            values[f"effects.{name}.where"] = tuple(instance.where for instance in instances)
            for key in instances[0].values:
                values[f"effects.{name}.{key}"] = tuple(instance.values[key] for instance in instances)
        return values

    def replaced(self, changes: Mapping[str, Any], source: str = "parameters") -> Config:
        """A copy with the dotted keys changed, validated as a file is.

        Raises:
            ConfigError: unknown key, wrong type, out of range, or inconsistent with the rest.
        """
        flat = {**self.flat(), "effects.active": self.active}  # what `standard` means is decided anew
        return config_from_flat({**flat, **changes}, source, self.directory)


def _flatten(section: Any, prefix: str = "") -> list[tuple[str, Value]]:
    values: list[tuple[str, Value]] = []
    for entry in dataclasses.fields(section):
        value = getattr(section, entry.name)
        if "parameter" in entry.metadata:
            values.append((prefix + entry.name, value))
        elif dataclasses.is_dataclass(value):
            values += _flatten(value, f"{prefix}{entry.name}.")
    return values


@cache
def parameter_table() -> dict[str, Parameter]:
    """Every parameter by its dotted name, effects included."""
    table: dict[str, Parameter] = {}

    def collect(section: Any, prefix: str) -> None:
        for entry in dataclasses.fields(section):
            value = getattr(section, entry.name)
            name = prefix + entry.name
            if "parameter" in entry.metadata:
                table[name] = dataclasses.replace(entry.metadata["parameter"], name=name, nominal=value)
            elif dataclasses.is_dataclass(value):
                collect(value, name + ".")

    collect(Config(), "")
    table["effects.active"] = Parameter(
        "effects.active",
        "strs",
        (STANDARD,),
        "",
        f"effects added to the paper's model, in any order; {STANDARD}: {', '.join(STANDARD_EFFECTS)} if the reference "
        f"is the motor side; {NOTHING}: no effect",
        choices=(STANDARD, NOTHING, *CATALOGUE),
    )
    for name, effect in CATALOGUE.items():
        where = f"effects.{name}.where"
        table[where] = Parameter(where, "strs", (), "", f"where {name} acts: {effect.place}; one entry an instance")
        for parameter in effect.parameters:
            key = f"effects.{name}.{parameter.name}"
            nominal = (float(parameter.nominal),)  # type: ignore[arg-type]
            table[key] = dataclasses.replace(parameter, name=key, kind="floats", nominal=nominal)
    return table


def config_from_flat(values: Mapping[str, Any], source: str, directory: Path = Path()) -> Config:
    """A validated configuration from dotted keys; keys not given are nominal.

    Raises:
        ConfigError: says the source, the key, the value and what is allowed.
    """
    table = parameter_table()
    checked: dict[str, Value] = {}
    for key, value in values.items():
        if key not in table:
            hint = difflib.get_close_matches(key, table, 1)
            raise ConfigError(f"{source}: {key}: unknown key{f'; did you mean {hint[0]!r}?' if hint else ''}")
        checked[key] = table[key].check(value, source)

    def build(section: Any, prefix: str) -> Any:
        changes = {}
        for entry in dataclasses.fields(section):
            name = prefix + entry.name
            current = getattr(section, entry.name)
            if "parameter" in entry.metadata:
                changes[entry.name] = checked.get(name, current)
            elif dataclasses.is_dataclass(current):
                changes[entry.name] = build(current, name + ".")
        return dataclasses.replace(section, **changes)

    config: Config = dataclasses.replace(build(Config(), ""), directory=directory)
    named: tuple[str, ...] = checked.get("effects.active", (STANDARD,))  # type: ignore[assignment]
    if NOTHING in named and len(named) > 1:
        raise ConfigError(f"{source}: effects.active: {NOTHING!r} stands alone, not with {', '.join(named)}")
    standard = STANDARD in named
    names = STANDARD_EFFECTS if standard and takes_standard(config) else ()
    active = dict.fromkeys((*names, *(name for name in named if name in CATALOGUE)))
    config = dataclasses.replace(config, standard=standard, effects=_effects(checked, active, source))
    _check_consistency(config, source)
    return config


def takes_standard(config: Config) -> bool:
    """Whether the standard effects can act: they need motor positions, and legs that are built alike."""
    legs = len(config.robot.left.joints), len(config.robot.right.joints)
    return config.prediction.reference == "motor" and legs[0] == legs[1]


def _effects(checked: Mapping[str, Value], active: Iterable[str], source: str) -> tuple[EffectConfig, ...]:
    effects: list[EffectConfig] = []
    for name in active:
        where: tuple[str, ...] = checked.get(f"effects.{name}.where", ()) or ("",)  # type: ignore[assignment]
        values: dict[str, tuple[float, ...]] = {}
        for parameter in CATALOGUE[name].parameters:
            key = f"effects.{name}.{parameter.name}"
            given: tuple[float, ...] = checked.get(key, (float(parameter.nominal),))  # type: ignore[assignment, arg-type]
            if len(given) not in (1, len(where)):
                raise ConfigError(
                    f"{source}: {key}: {len(given)} values for {len(where)} places (effects.{name}.where)"
                )
            values[parameter.name] = given * len(where) if len(given) == 1 else given
        for index, place in enumerate(where):
            CATALOGUE[name].check_place(place, f"{source}: effects.{name}.where")
            effects.append(EffectConfig(name, place, {key: given[index] for key, given in values.items()}))
    return tuple(effects)


def _check_consistency(config: Config, source: str) -> None:
    for side, leg in (("left", config.robot.left), ("right", config.robot.right)):
        for key in ("stiffness", "damping"):
            count = len(getattr(leg, key))
            if count != len(leg.joints):
                raise ConfigError(
                    f"{source}: robot.{side}.{key}: {count} values for {len(leg.joints)} joints (robot.{side}.joints)"
                )
        if len(set(leg.joints)) != len(leg.joints):
            raise ConfigError(f"{source}: robot.{side}.joints: a joint is named twice: {', '.join(leg.joints)}")
    active = {effect.name for effect in config.effects}
    for name in sorted(active):
        for needed in CATALOGUE[name].needs:
            if needed not in active:
                raise ConfigError(f"{source}: effects.active: {name} acts with {needed} alone, which is not active")
    if config.turning and config.prediction.reference != "motor":
        raise ConfigError(
            f"{source}: effects.active: trunk_rotation needs the motor side (prediction.reference: motor), "
            f"not {config.prediction.reference!r}"
        )
    if config.turning and len(config.robot.left.joints) != len(config.robot.right.joints):
        raise ConfigError(
            f"{source}: effects.active: trunk_rotation needs legs of equally many joints, "
            f"not {len(config.robot.left.joints)} and {len(config.robot.right.joints)} (robot.left.joints)"
        )
    if config.support.contact_off >= config.support.contact_on:
        raise ConfigError(
            f"{source}: support.contact_off: {config.support.contact_off} must be below "
            f"support.contact_on = {config.support.contact_on}"
        )


def load_config(path: str | Path | None = None, node: str = "predictor", ignored: tuple[str, ...] = ()) -> Config:
    """Read a ROS 2 parameter file: the sections `/**` and then that of the node, if any.

    Args:
        path: of the file; default: the shipped coman.yaml.
        node: whose section counts.
        ignored: keys that are not looked at, nor are those that every ROS 2 node has.

    Raises:
        ConfigError: the file cannot be read or a value in it is not allowed.

    Example:
        >>> import coman_reduced_model as coman
        >>> config = coman.load_config(coman.config_path("coman_paper")).replaced({"prediction.horizons": [0.2]})
        >>> config.prediction.horizons, config.active
        ((0.2,), ())
        >>> path = coman.save_config(config, "mine.yaml")
        >>> coman.load_config(path).flat() == config.flat()
        True
    """
    path = Path(config_path() if path is None else path)
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{path}: is not YAML{where}: {getattr(error, 'problem', error)}") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: wanted a ROS 2 parameter file: '/**:' with 'ros__parameters:' below it")
    values: dict[str, Any] = {}
    for section, body in document.items():
        if not isinstance(body, dict) or not isinstance(body.get("ros__parameters"), dict):
            raise ConfigError(f"{path}: {section}: wanted 'ros__parameters:' below a node's name or '/**'")
        flat = _flat_yaml(body["ros__parameters"])
        flat = {key: value for key, value in flat.items() if key not in ignored and not _foreign(key)}
        name = str(section).rsplit("/", 1)[-1]
        if name in ("**", "*", node):
            values.update(flat)
        else:  # meant for another node: checked all the same, so that a mistake is found now and not there
            config_from_flat(flat, f"{path}: {section}")
    return config_from_flat(values, str(path), path.parent)


def _foreign(key: str) -> bool:
    """Parameters that every ROS 2 node has."""
    return key in ("use_sim_time", "start_type_description_service") or key.startswith("qos_overrides.")


def _flat_yaml(tree: Mapping[Any, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(_flat_yaml(value, name + "."))
        else:
            flat[name] = value
    return flat


def config_to_yaml(config: Config, comment: str = "") -> str:
    """The configuration as a ROS 2 parameter file, each value with its description and unit."""
    table = parameter_table()
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += ["/**:", "  ros__parameters:"]
    for key, value in config.flat().items():
        if key == "effects.active":
            value = config.active or (NOTHING,)
        if value == ():  # ROS parameter files have no empty lists; the nominal is empty as well
            continue
        parameter = table[key]
        plain = list(value) if isinstance(value, tuple) else value
        # Quoted where a text holds line breaks and the like: one line a key.
        quotes = None if str(value).isprintable() and "\\" not in str(value) else '"'
        text = yaml.safe_dump(plain, default_flow_style=True, default_style=quotes, width=10**6)
        text = text.removesuffix("...\n").strip("\n")
        unit = f" [{parameter.unit}]" if parameter.unit not in ("", "1") else ""
        lines.append(f"    {key}: {text}  # {parameter.description}{unit}")
    return "\n".join(lines) + "\n"


def save_config(config: Config, path: str | Path, comment: str = "", force: bool = False) -> Path:
    """Write a configuration as a parameter file, whole or not at all; a URDF that it names is found from there as well.

    Args:
        config: to be written.
        path: of the file.
        comment: its first lines.
        force: replace a file that exists.

    Raises:
        OutputError: it exists (without `force`), or cannot be written.
    """
    path = check_file(path, force)
    if config.robot.urdf:
        config = config.replaced({"robot.urdf": os.path.relpath(config.directory / config.robot.urdf, path.parent)})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.part")
        partial.write_text(config_to_yaml(config, comment), encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
    return path
