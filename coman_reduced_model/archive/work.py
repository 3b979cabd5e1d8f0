# SPDX-License-Identifier: BSD-3-Clause
"""What a worker does with one task. Each result is a part file, written by the worker itself under the task's name."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml

from ..bag.reader import Bag
from ..bag.session import Session
from ..core.config.schema import Config
from ..errors import ComanError, ConfigError
from ..output import to_json
from ..resources import PACKAGE, version
from ..topics import TopicNames
from .inventory import METADATA, StoredBag
from .memory import memory_watched
from .store import Store
from .tables import VERSION

PARTS = "parts"
OK, DAMAGED, BAD, FAILED, MEMORY, DIED = "ok", "damaged", "bad", "failed", "memory", "died"
USABLE = (OK, DAMAGED)
Row = dict[str, Any]


def _text(path: Path | None) -> str:
    """Of a file; "" without one, and where it cannot be read, which each bag says."""
    try:
        return path.read_text(encoding="utf-8", errors="replace") if path else ""
    except OSError:
        return ""


@dataclass(frozen=True)
class Settings:
    """How bags are predicted and diagnosed.

    Attributes:
        urdf: text of a URDF file that replaces those of the bags, or empty.
        namespace, remaps: where the topics are.
        predict: whether bags are predicted.
        memory_mb: how much a worker may take; 0: no limit.
    """

    config: Config
    urdf: str = ""
    namespace: str = ""
    remaps: tuple[str, ...] = ()
    predict: bool = True
    memory_mb: int = 2048

    @property
    def names(self) -> TopicNames:
        """Of the topics."""
        return TopicNames(self.namespace, self.remaps)

    def digest(self) -> str:
        """The same for the same settings and the same contents of the files that they name."""
        files = [_text(self.config.urdf), _text(self.config.baseline)]
        values = [self.config.flat(), self.urdf, self.namespace, self.remaps, self.predict, files]
        return key_of(values)[:16]


@dataclass(frozen=True)
class BagTask:
    """One bag.

    Attributes:
        part: name of the part file; version: of the package that the driver has, which a worker must have too.
        out: URI of the folder of the results.
    """

    part: str
    version: str
    bag: StoredBag
    settings: Settings
    out: str

    @classmethod
    def named(cls, bag: StoredBag, settings: Settings, out: str) -> BagTask:
        """With the name of its part: of the bag as it is stored, the version of the package here, and the settings."""
        files, made_by = [(file.path, file.size, file.tag) for file in bag.files], version()
        key = key_of([VERSION, bag.archive, bag.bag, files, made_by, settings.digest()])
        return cls(f"{PARTS}/bag-{key[:32]}.json", made_by, bag, settings, out)

    def run(self) -> str:
        """Read and predict the bag."""
        return _guarded(self._rows, self, self.bag.bag)

    def _rows(self) -> Row:
        with self.bag.opened() as path:
            row, rest = self._read(path)
        return {**row, **rest}

    def _read(self, path: Path) -> tuple[Row, Row]:
        row: Row = {"status": OK, "reason": None, "recorded_robot": "", "start_ns": None}
        with suppress(OSError):
            row["hash"] = self.bag.digest(path)
        try:
            row["recorded_robot"] = _recorded_robot(path)
            with Bag(path) as bag:
                row.update(start_ns=bag.start_ns, duration_s=bag.duration_s)
            with ExitStack() as stack:
                urdf = _urdf_file(self.settings.urdf, stack)
                settings = self.settings
                session = stack.enter_context(Session(path, settings.config, urdf=urdf, names=settings.names))
                row["mass_kg"] = session.robot.mass
                rest = self._predicted(session) if self.settings.predict else {}
                if session.bag.warnings:
                    row.update(status=DAMAGED, reason=_plain(session.bag.warnings[0], path, self.bag.bag))
            rest["warnings"] = [_plain(line, path, self.bag.bag) for line in rest.get("warnings", ())]
            return row, rest
        except ComanError as error:
            return {**row, "status": BAD, "reason": _plain(str(error), path, self.bag.bag)}, {}

    def _predicted(self, session: Session) -> Row:
        from ..offline import summarise_bag

        summary = summarise_bag(session)
        phases = [
            {
                "phase": phase,
                "duration_s": summary["phases_s"].get(phase),
                "samples": errors["samples"],
                **_errors(errors),
            }
            for phase, errors in sorted(summary["by_phase"].items())
        ]
        return {
            "samples": summary["samples"],
            "judged_samples": summary["judged_samples"],
            **_errors(summary),
            "skill": [{"horizon_s": float(h), **skill} for h, skill in summary["skill"].items()],
            "rejected": sum(summary["rejected"].values()),
            "restarts": summary["restarts"],
            "warnings": summary["warnings"],
            "phases": phases,
            "mismatches": [_mismatch(each) for each in summary["mismatches"]],
        }


@dataclass(frozen=True)
class DiagnosisTask:
    """Bags of one robot in one period, with their hashes: some to fit, some held out; the rest as in `BagTask`."""

    part: str
    version: str
    robot: str
    period: str
    train: tuple[StoredBag, ...]
    holdout: tuple[StoredBag, ...]
    hashes: tuple[str, ...]
    settings: Settings
    out: str

    @classmethod
    def named(
        cls, of: tuple[str, str], train: Sequence[StoredBag], holdout: Sequence[StoredBag], hashes: tuple[str, ...],
        settings: Settings, out: str,
    ) -> DiagnosisTask:  # fmt: skip
        """With the name of its part: of the contents of the bags, in this order, the version, and the settings.

        `of` is robot and period.
        """
        made_by = version()
        key = key_of([VERSION, hashes, len(train), made_by, settings.digest()])
        name = f"{PARTS}/diagnosis-{key[:32]}.json"
        return cls(name, made_by, *of, tuple(train), tuple(holdout), hashes, settings, out)

    @property
    def bags(self) -> list[str]:
        """Their paths, as in the table of bags."""
        return [bag.bag for bag in (*self.train, *self.holdout)]

    def run(self) -> str:
        """Diagnose the bags together."""
        return _guarded(self._rows, self, ", ".join(self.bags))

    def _rows(self) -> Row:
        from ..diagnose.workflow import diagnose

        settings = self.settings
        with ExitStack() as stack:
            paths = [stack.enter_context(bag.opened()) for bag in (*self.train, *self.holdout)]
            train, hold = paths[: len(self.train)], paths[len(self.train) :]
            urdf = _urdf_file(settings.urdf, stack)
            try:
                found = diagnose(train, hold, settings.config, urdf=urdf, names=settings.names, second_process=False)
            except ComanError as error:
                text = str(error)
                for path, name in zip(paths, self.bags, strict=True):
                    text = _plain(text, path, name)
                return {"status": BAD, "reason": text, "findings": [{}]}
        result = found.result
        common = {"verdict": result["verdict"], "sentence": result["sentence"]}
        named = result["effects"] if result["verdict"] == "effect" else []  # minor ones are in the sentence
        effects = [{**common, **_effect(effect)} for effect in named]
        return {"status": OK, "reason": None, "findings": effects or [common]}


Task = BagTask | DiagnosisTask


def run_task(task: Task) -> str:
    """Do a task; the status of its part.

    Raises:
        ConfigError: the package here has another version than the driver's: a table is made by one.
    """
    if task.version != version():
        raise ConfigError(f"a worker has {PACKAGE} {version()}, this command {task.version}: all nodes need the same")
    return task.run()


def died() -> Row:
    """The part of a task whose process was killed each time; it is not stored, so that the next run tries again."""
    return {"status": DIED, "reason": "its process was killed twice", "findings": [{}]}


def key_of(value: Any) -> str:
    """SHA-256 of a value of JSON."""
    return sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def _guarded(work: Callable[[], Row], task: Task, what: str) -> str:
    """Write the part of a task whatever happens: nothing that a bag does ends the archive. The status."""
    store, most = Store(task.out), task.settings.memory_mb

    def write(rows: Row) -> str:
        store.write(task.part, (to_json(rows) + "\n").encode())
        return str(rows["status"])

    def without_result(status: str, reason: str) -> Row:
        return {"status": status, "reason": reason, "findings": [{}]}

    if store.exists(task.part):  # of a worker that took too much memory: it wrote that, and ended
        return str(json.loads(store.read(task.part))["status"])
    too_much = without_result(MEMORY, f"{what}: takes more than {most} MB (--memory)")
    with memory_watched(most, lambda: write(too_much)):
        try:
            rows = work()
        except ComanError as error:
            rows = without_result(BAD, str(error))
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(last.filename).name}:{last.lineno}"
            text = " ".join(str(error).split())[:200]
            rows = without_result(FAILED, f"{what}: {type(error).__name__} at {where}: {text}")
    return write(rows)


def _recorded_robot(path: Path) -> str:
    """`robot` of the custom data of a recording (ros2 bag record --custom-data robot=NAME)."""
    try:
        text = (path / METADATA).read_text(encoding="utf-8")
        custom = yaml.safe_load(text)["rosbag2_bagfile_information"]["custom_data"]
        return str(custom["robot"])
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return ""


def _urdf_file(text: str, stack: ExitStack) -> Path | None:
    if not text:
        return None
    from tempfile import TemporaryDirectory

    file = Path(stack.enter_context(TemporaryDirectory(prefix="coman_archive_")), "robot.urdf")
    file.write_text(text, encoding="utf-8")
    return file


def _errors(found: Row) -> Row:
    return {
        f"{key}_{axis}_m": value
        for key, errors in (("rmse", "rmse_m"), ("rmse_rigid", "rmse_rigid_m"))
        for axis, value in found[errors].items()
    }


def _mismatch(found: Row) -> Row:
    size = {"name": "size", "value": found["size"], "low": None, "high": None, "unit": found["unit"]}
    sigma = {"name": "sigma", "value": found["sigma"], "low": None, "high": None, "unit": ""}
    return {
        "place": found["channel"],
        "parameters": [size, sigma],
        "since_s": found["since_s"],
        "sentence": found["text"],
    }


def _effect(found: Row) -> Row:
    parameters = []
    for name, each in found["parameters"].items():
        low, high = _interval(each["interval"])
        parameters.append({"name": name, "value": each["value"], "low": low, "high": high, "unit": each["unit"]})
    return {
        "effect": found["name"],
        "place": found["where"],
        "parameters": parameters,
        "evidence": found.get("evidence"),
        "share": found["explains"]["share"],
    }


def _interval(ends: Sequence[float | None]) -> tuple[float | None, float | None]:
    return (ends[0], ends[1]) if len(ends) == 2 else (None, None)


def _plain(text: str, path: Path, name: str) -> str:
    """A message without the place where this machine had the bag."""
    return " ".join(text.replace(str(path), name).split())
