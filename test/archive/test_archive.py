# SPDX-License-Identifier: BSD-3-Clause
"""An archive is worked off by processes that may be killed: the tables are the same, and bad bags are rows."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from conftest import PATIENCE, ROOT, child_environment
from jsonschema import Draft202012Validator
from pyarrow import parquet
from synthetic import T0, walk, write_bag

from coman_reduced_model.archive import work
from coman_reduced_model.archive.inventory import find_bags
from coman_reduced_model.archive.robots import date_of, period_of, read_robots, robot_of
from coman_reduced_model.archive.run import Run, diagnoses
from coman_reduced_model.archive.store import Store
from coman_reduced_model.archive.tables import TABLES, arrow_schema, read_table, write_table
from coman_reduced_model.archive.work import BagTask, DiagnosisTask, Settings, run_task
from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.errors import ComanError, ConfigError
from coman_reduced_model.resources import version
from coman_reduced_model.schemas import schema

COMAN = (sys.executable, "-m", "coman_reduced_model.cli.main", "archive")
BAGS = {"anna/walk_1": 1.5, "anna/walk_2": 1.0, "bert/walk_1": 1.2, "bert/deep/walk_2": 1.1}
DAY = "2023-11-14"  # of T0


@pytest.fixture(scope="module")
def walks(tmp_path_factory) -> Path:
    """Four bags of two robots; one that holds no bag, and one without wrenches."""
    folder = tmp_path_factory.mktemp("archive") / "walks"
    for name, seconds in BAGS.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_bag(folder / name, walk(seconds))
    write_bag(folder / "anna/no_wrench", walk(0.5), skip=("left_foot/wrench",))
    (folder / "lost.mcap").write_bytes(b"\0" * 1000)
    return folder


@pytest.fixture(scope="module")
def whole(walks) -> Path:
    """The tables, made by one process in this one's order."""
    out = walks.parent / "whole"
    assert run(["archive", str(walks), "--predict", "--workers", "1", "--out", str(out)]) == 0
    return out


def rows(out: Path, table: str) -> list[dict]:
    return parquet.read_table(out / f"{table}.parquet").to_pylist()


def contents(out: Path) -> dict[str, bytes]:
    return {name: (out / f"{name}.parquet").read_bytes() for name in TABLES}


@pytest.mark.slow
def test_each_bag_is_a_row_bad_ones_with_their_reason(whole):
    found = {row["bag"]: row for row in rows(whole, "bags")}
    assert {*found} == {*BAGS, "anna/no_wrench", "lost.mcap"}
    for name, seconds in BAGS.items():
        row = found[name]
        assert row["status"] == "ok" and row["reason"] is None and row["robot"] == name.split("/")[0]
        assert str(row["date"]) == DAY and abs(row["samples"] - 200 * seconds) < 5
        assert 0.0 < row["rmse_x_m"] < 0.1 and row["judged_samples"] > 100 and len(row["hash"]) == 64
    assert found["anna/no_wrench"]["status"] == "bad" and "left_foot/wrench" in found["anna/no_wrench"]["reason"]
    assert found["lost.mcap"]["status"] == "bad" and found["lost.mcap"]["reason"].startswith("lost.mcap: neither")
    assert {row["phase"] for row in rows(whole, "phases") if row["bag"] == "anna/walk_1"} >= {"LEFT", "DOUBLE"}


def test_tables_are_as_their_schema_says(whole):
    for name in TABLES:
        found = parquet.read_schema(whole / f"{name}.parquet")
        assert found.equals(arrow_schema(name), check_metadata=True)
        of_a_row = Draft202012Validator({**schema("archive"), "$ref": f"#/$defs/{name}"})
        for row in rows(whole, name):
            of_a_row.validate(json.loads(json.dumps(row, default=str)))
            assert not of_a_row.is_valid({**row, "robot": 5})


def test_newer_tables_are_refused_and_older_ones_have_nulls(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "new")
    table = read_table(Store(str(whole)), "bags")
    newer = table.replace_schema_metadata({b"coman_schema_version": b"2"})
    parquet.write_table(newer, tmp_path / "new/bags.parquet")
    with pytest.raises(ComanError, match="schema version '2'"):
        read_table(Store(str(tmp_path / "new")), "bags")
    parquet.write_table(table.drop_columns(["mass_kg"]), tmp_path / "new/bags.parquet")
    assert set(read_table(Store(str(tmp_path / "new")), "bags")["mass_kg"].to_pylist()) == {None}


def test_a_part_is_not_made_twice(whole, walks, capsys):
    before = contents(whole)
    parts = {path: path.stat().st_mtime_ns for path in (whole / "parts").iterdir()}
    assert run(["archive", str(walks), "--predict", "--out", str(whole), "--json"]) == 0
    assert '"tasks": 0' in capsys.readouterr().out
    assert contents(whole) == before
    assert {path: path.stat().st_mtime_ns for path in (whole / "parts").iterdir()} == parts


def children(pid: int) -> list[int]:
    """Workers of a process: those of its children that run tasks."""
    found = subprocess.run(["pgrep", "-f", "-P", str(pid), "spawn_main"], capture_output=True, text=True, check=False)
    return [int(line) for line in found.stdout.split()]


def waited(what, seconds: float = PATIENCE):
    """What a function gives, as soon as it is anything."""
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return found


def alive(pid: int) -> bool:
    """Whether a process runs; one that ended and that nobody asked for does not."""
    status = Path(f"/proc/{pid}/status")
    return status.is_file() and "\nState:\tZ" not in status.read_text()


@pytest.mark.slow
def test_killed_workers_and_a_killed_archive_change_nothing(walks, whole, tmp_path):
    out = tmp_path / "killed"
    command = [
        sys.executable,
        "-m",
        "coman_reduced_model.cli.main",
        "archive",
        str(walks),
        "--predict",
        "--out",
        str(out),
    ]

    def start() -> subprocess.Popen:
        return subprocess.Popen(command, cwd=ROOT, env=child_environment(), stderr=subprocess.DEVNULL)

    with start() as archive:  # two workers
        waited(lambda: [*out.glob("parts/*.json")])
        workers = waited(lambda: children(archive.pid))
        archive.send_signal(signal.SIGKILL)
    waited(
        lambda: (
            not any(
                Path(f"/proc/{pid}/cmdline").is_file() and Path(f"/proc/{pid}/cmdline").read_bytes() for pid in workers
            )
        )
    )
    assert not (out / "bags.parquet").exists()
    done = len([*out.glob("parts/*.json")])
    with start() as archive:
        if done < len(BAGS) + 2:
            for pid in waited(lambda: children(archive.pid) or (archive.poll() is not None and [0])):
                if pid:
                    os.kill(pid, signal.SIGKILL)  # what it had in hand is tried again by another
        assert archive.wait(300) == 0
    assert contents(out) == contents(whole)


def family(pid: int) -> list[int]:
    """A process and all that it, and they, have started."""
    parents: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            parents.setdefault(parent, []).append(int(stat.parent.name))
    found = [pid]
    for each in found:
        found += parents.get(each, [])
    return found


def listening(pids: list[int]) -> set[str]:
    """Addresses at which processes take connections, as /proc/net writes them."""
    sockets = set()
    for pid in pids:
        with suppress(OSError):
            for descriptor in Path(f"/proc/{pid}/fd").iterdir():
                with suppress(OSError):
                    sockets.add(str(descriptor.readlink()))
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path("/proc/net", name).read_text().splitlines()[1:]]
    return {row[1].partition(":")[0] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in sockets}


LOOPBACK = {"0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000"}


def on_ray(walks: Path, out: Path) -> subprocess.Popen:
    """`coman archive` by Ray of this machine."""
    pytest.importorskip("ray")
    command = [*COMAN, str(walks), "--predict", "--address", "local", "--out", str(out)]
    return subprocess.Popen(command, cwd=ROOT, env=child_environment(), stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_ray_gives_the_same_tables_and_is_reached_by_this_machine_only(walks, whole, tmp_path):
    found: list[set[str]] = []
    with on_ray(walks, tmp_path / "ray") as archive:
        while archive.poll() is None:
            found.append(listening(family(archive.pid)))
            time.sleep(0.1)
        assert archive.returncode == 0, archive.stderr.read()
    assert contents(tmp_path / "ray") == contents(whole)
    addresses = set.union(*found)
    assert addresses and addresses <= LOOPBACK


@pytest.mark.slow
def test_a_killed_worker_of_ray_costs_its_bag_alone(walks, whole, tmp_path):
    out = tmp_path / "ray"

    def stopped() -> int:
        """A worker that has a bag in hand, and goes no further."""
        for pid in family(archive.pid):
            with suppress(OSError):
                title = Path(f"/proc/{pid}/cmdline")
                if title.read_bytes().startswith(b"ray::run_task"):
                    os.kill(pid, signal.SIGSTOP)
                    if title.read_bytes().startswith(b"ray::run_task"):
                        return pid
                    os.kill(pid, signal.SIGCONT)
        assert archive.poll() is None, "all was done before a worker could be killed"
        return 0

    with on_ray(walks, out) as archive:
        waited(lambda: [*out.glob("parts/*.json")])
        worker = waited(stopped)
        parts = {path: path.stat().st_mtime_ns for path in out.glob("parts/*.json")}
        os.kill(worker, signal.SIGKILL)
        assert archive.wait(300) == 0, archive.stderr.read()
    assert len(parts) < len([*out.glob("parts/*.json")]) == len(BAGS) + 2
    assert {path: path.stat().st_mtime_ns for path in parts} == parts, "what others had done is not done again"
    assert contents(out) == contents(whole)


def test_a_worker_of_another_version_is_refused_with_both(walks, tmp_path, monkeypatch, capsys):
    """Its part would have another name, which nobody would look for after all the work."""
    bags = find_bags([str(walks / "bert")])
    tasks = [
        BagTask.named(bags[0], Settings(Config()), str(tmp_path)),
        DiagnosisTask.named(("bert", "2023-11"), bags[:1], bags[1:], ("a", "b"), Settings(Config()), str(tmp_path)),
    ]
    parts = [task.part for task in tasks]
    monkeypatch.setattr(work, "version", lambda: "9.8.7")
    assert [task.part for task in tasks] == parts, "the name is the driver's"
    for task in tasks:
        with pytest.raises(ConfigError, match=rf"has coman_reduced_model 9\.8\.7, this command {re.escape(version())}"):
            run_task(task)
    assert not [*tmp_path.iterdir()]
    out = tmp_path / "out"  # the processes of workers have what is installed
    assert run(["archive", str(walks / "bert"), "--workers", "1", "--out", str(out)]) == 2
    (line,) = [each for each in capsys.readouterr().err.splitlines() if each.startswith("coman: ")]
    assert f"has coman_reduced_model {version()}, this command 9.8.7" in line


@pytest.mark.slow
def test_a_worker_of_ray_of_another_version_is_refused(walks, tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")
    from coman_reduced_model.archive.cluster import run_on_ray

    (task, *_) = (BagTask.named(bag, Settings(Config()), str(tmp_path)) for bag in find_bags([str(walks / "bert")]))
    for name in ("RAY_USAGE_STATS_ENABLED", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"):
        monkeypatch.setenv(name, "0")  # which it sets itself: as before, afterwards
    with pytest.raises(ConfigError) as raised:
        [*run_on_ray([replace(task, version="9.8.7")], "local", 1)]
    assert str(raised.value).startswith(f"a worker has coman_reduced_model {version()}, this command 9.8.7")
    assert "\n" not in str(raised.value) and not ray.is_initialized()


@pytest.mark.slow
def test_what_takes_too_much_memory_is_a_row(walks, tmp_path):
    out = tmp_path / "small"
    assert run(["archive", str(walks / "bert"), "--predict", "--memory", "1", "--workers", "1", "--out", str(out)]) == 0
    assert [row["status"] for row in rows(out, "bags")] == ["memory", "memory"]
    assert all("takes more than 1 MB (--memory)" in row["reason"] for row in rows(out, "bags"))
    assert run(["archive", str(walks / "bert"), "--predict", "--workers", "1", "--out", str(out)]) == 0
    assert [row["status"] for row in rows(out, "bags")] == ["ok", "ok"], "with more memory it is tried again"


def test_a_folder_of_something_else_is_not_written_to(walks, tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    assert run(["archive", str(walks), "--out", str(tmp_path)]) == 2
    assert run(["archive", str(tmp_path / "nothing"), "--out", str(tmp_path / "out")]) == 2
    assert run(["archive", "noway://walks", "--out", str(tmp_path / "out")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 3 and "mine.txt" in lines[0] and "no such folder" in lines[1] and "noway" in lines[2]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.txt"]


def test_robot_and_date_come_from_table_recording_folder_and_configuration(tmp_path):
    file = tmp_path / "robots.csv"
    file.write_text("bag,robot,date\nlab/*,carl,\nlab/old,,2020-02-03\n")
    table = read_robots(file)
    assert robot_of("lab/x", "dora", "coman", table) == "carl"
    assert robot_of("hall/x", "dora", "coman", table) == "dora"
    assert robot_of("hall/x", "", "coman", table) == "hall"
    assert robot_of("x.mcap", "", "coman", table) == "coman"
    assert str(date_of("lab/old", T0, table)) == "2020-02-03" and str(date_of("lab/x", T0, table)) == DAY
    assert date_of("lab/x", 5_000_000_000, table) is None, "a simulation that begins at zero"
    assert period_of(date_of("lab/x", T0, table), "week") == "2023-W46"
    file.write_text("bag,robot,date\nx,y,3 May\n")
    with pytest.raises(ComanError, match="line 2"):
        read_robots(file)


def test_bags_before_and_after_a_change_are_not_diagnosed_together(whole, walks):
    bags = [bag for bag in find_bags([str(walks)]) if bag.bag in BAGS] * 3
    table = [
        {**rows(whole, "bags")[0], "robot": "anna", "hash": str(i), "start_ns": i}
        | {f"rmse_{axis}_m": 0.001 * (1.0 + 0.01 * (i % 3)) * (3.0 if i >= 7 else 1.0) for axis in "xyz"}
        for i in range(12)
    ]
    table[0]["status"] = "ok"
    for row in table:
        row.update(status="ok", date=date_of("", T0, []))
    tasks = diagnoses(Run((str(walks),), "out", Settings(Config())), bags, table)
    assert [len(task.train) + len(task.holdout) for task in tasks] == [5, 5]
    before, after = (set(map(int, task.hashes)) for task in tasks)
    assert max(before) < 7 <= min(after)


def test_a_copy_of_a_bag_leaves_the_others_to_be_diagnosed(whole, walks):
    bags = [bag for bag in find_bags([str(walks)]) if bag.bag in BAGS][:1] * 4
    table = [
        {**rows(whole, "bags")[0], "robot": "anna", "status": "ok", "hash": each, "start_ns": 0}
        | {"date": date_of("", T0, []) + timedelta(days=day)}
        for each, day in (("c", 2), ("a", 0), ("a", 3), ("b", 1))
    ]
    (task,) = diagnoses(Run((str(walks),), "out", Settings(Config()), every="month"), bags, table)
    assert task.hashes == ("a", "b", "c")  # by date, which a table may know better than the stamps


def test_what_files_of_the_configuration_say_belongs_to_the_settings(tmp_path):
    (tmp_path / "robot.urdf").write_text("<robot/>")
    settings = Settings(replace(Config().replaced({"robot.urdf": "robot.urdf"}), directory=tmp_path))
    before = settings.digest()
    assert settings.digest() == before
    (tmp_path / "robot.urdf").write_text("<robot name='other'/>")
    assert settings.digest() != before


def test_results_in_a_folder_with_brackets_are_read(tmp_path):
    store = Store(str(tmp_path / "res[1]*"))
    store.write("parts/a.json", b"{}")
    assert store.read_all(["parts/a.json", "parts/b.json"]) == {"parts/a.json": b"{}"}


def test_a_store_of_another_kind_is_read_and_written():
    """Objects in memory stand for an object store: no folders, no renaming."""
    store = Store("memory://walks/results")
    store.write("parts/a.json", b"{}")
    assert store.local_path() is None and store.names("parts") == ["a.json"]
    assert store.read_all(["parts/a.json", "parts/b.json"]) == {"parts/a.json": b"{}"}
    write_table(store, "phases", [])
    assert read_table(store, "phases").num_rows == 0
    Store("memory://walks/bags").write("bert/one.mcap", b"12")
    (bag,) = find_bags(["memory://walks/bags"])
    with bag.opened() as path:
        assert bag.bag == "bert/one.mcap" and path.read_bytes() == b"12"
    assert not path.exists()
