# SPDX-License-Identifier: BSD-3-Clause
"""How well support phase and odometry are found: against the simulator's contacts, or on recordings.

    python bench/phases.py --seeds 5                            # the virtual robot, tests 1 and 2, seeds 1 to 5
    python bench/phases.py BAG --config config/icub.yaml        # a recording: foot motion and, if there, base pose

Right: share of samples with the true phase. Late: from the true change of a contact (force above 1 N for 20 ms) to the
sample that reports it, mean of the absolute values and largest. Spurious: changes without a true one within 100 ms.
Swings: upward excursions of a sole by 10 mm against the other sole, from the joints alone; matched: single supports
that overlap exactly one swing of the right foot. Drift: of the base in odom against the motion capture, both aligned at
the start.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.bag.session import find_robot
from coman_reduced_model.core.base.types import Array, Foot, Phase, Sample
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.effects.catalogue import build_effects, stream_delays
from coman_reduced_model.core.gait.gait import plan_walk
from coman_reduced_model.core.gait.parameters import gait
from coman_reduced_model.core.measured.odometry import FootOdometry, base_in_odom
from coman_reduced_model.core.measured.support import SupportDetector
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.streams.joiner import Joiner
from coman_reduced_model.messages import joint_from, wrench_from
from coman_reduced_model.resources import config_path
from coman_reduced_model.sim.describe import urdf
from coman_reduced_model.sim.motion import plan_motion
from coman_reduced_model.sim.robot_table import COMAN
from coman_reduced_model.sim.sensors import SensorOptions
from coman_reduced_model.sim.virtual_robot import VirtualRobot
from coman_reduced_model.topics import TopicNames

CONTACT, SETTLE, MATCH = 1.0, 0.02, 0.1  # [N], [s], [s]
JOINTS, LEFT, RIGHT = "/joint_states", "/left_foot/wrench", "/right_foot/wrench"
TRUE_BASE = "/ground_truth/base_pose"


@dataclass
class Track:
    """What was found at each sample."""

    t: Array  # (n,) [s]
    phase: Array  # (n,) int
    foot: Array  # (n,) int
    lift: Array  # (n,) [m] height of the right sole above the left one
    base: Array  # (n, 4, 4) in odom


def follow(robot: Robot, config: Config, samples: list[Sample], start_ns: int) -> Track:
    """Runs detector and odometry over samples."""
    detector = SupportDetector(config.support, robot.mass * config.robot.gravity)
    odometry, posture = FootOdometry(), robot.posture()
    rows = []
    for sample in samples:
        left, right = sample.left_wrench, sample.right_wrench
        state = detector.update(
            sample.stamp_ns, None if left is None else float(left[2]), None if right is None else float(right[2])
        )
        posture.update(sample.q, sample.qd)
        R, p, foot = posture.R, posture.p, state.support_foot
        T = odometry.update(foot, R[Foot.LEFT], p[Foot.LEFT], R[Foot.RIGHT], p[Foot.RIGHT])
        base = base_in_odom(T, R[foot], p[foot]) if foot else np.full((4, 4), np.nan)
        lift = posture.sole_to_sole(Foot.LEFT, Foot.RIGHT)[1][2]
        rows.append(((sample.stamp_ns - start_ns) * 1e-9, int(state.phase), int(foot), lift, base))
    return Track(*(np.array(column) for column in zip(*rows, strict=True)))


def changes(t: Array, contact: Array) -> list[tuple[float, bool]]:
    """Times [s] at which a contact began (True) or ended."""
    edges = np.flatnonzero(np.diff(contact.astype(int))) + 1
    return [(float(t[i]), bool(contact[i])) for i in edges]


def settled(t: Array, contact: Array) -> Array:
    """The contact without changes that last less than SETTLE."""
    contact = contact.copy()
    edges = np.concatenate([[0], np.flatnonzero(np.diff(contact.astype(int))) + 1, [len(t)]])
    for a, b in zip(edges[1:-2], edges[2:-1], strict=True):
        if t[b] - t[a] < SETTLE:
            contact[a:b] = contact[a - 1]
    return contact


def virtual(name: str, seed: int, config: Config, sensors: SensorOptions) -> dict[str, float]:
    """Walks the virtual robot and judges the phases against its contacts."""
    motion, _ = plan_motion(COMAN, plan_walk(gait(name, **COMAN.gait)))
    virtual_robot = VirtualRobot(COMAN, sensors, seed=seed)
    virtual_robot.reset(motion)
    robot = Robot(urdf(COMAN), config.robot)
    joiner, samples, truth = Joiner(robot, config, stream_delays(build_effects(config.effects, robot)[0])), [], []
    while virtual_robot.t < motion.end:
        readings = virtual_robot.step()
        if readings.joint_states:
            samples += joiner.add_joint(readings.joint_states)
        for foot, wrench in ((Foot.LEFT, readings.left_wrench), (Foot.RIGHT, readings.right_wrench)):
            if wrench:
                samples += joiner.add_wrench(foot, wrench)
        now = virtual_robot.truth
        truth.append((now.t, now.left_wrench[2], now.right_wrench[2], now.T_left, now.T_right, now.base_position))
    samples += joiner.flush()
    start_ns = virtual_robot.start_ns
    track = follow(robot, config, samples, start_ns)
    t, left, right, T_left, _, base = (np.array(column) for column in zip(*truth, strict=True))
    at = np.clip(np.round(track.t / virtual_robot.period).astype(int), 0, len(t) - 1)
    true_phase = (left > CONTACT) + 2 * (right > CONTACT)
    late, spurious, missed = [], 0, 0
    for bit, force in ((1, left), (2, right)):
        true = changes(t, settled(t, force > CONTACT))
        for time, on in changes(track.t, (track.phase & bit) > 0):
            near = [item for item in true if item[1] == on and abs(item[0] - time) < MATCH]
            if near:
                match = min(near, key=lambda item: abs(item[0] - time))
                true.remove(match)
                late.append(time - match[0])
            else:
                spurious += 1
        missed += len(true)
    # Drift of the base against the world, odom being aligned with the true pose of the first support sole.
    first = np.argmax(track.foot > 0)
    origin = (np.array([row[3 if track.foot[first] == 1 else 4] for row in truth]))[at[first]]
    guess = (origin @ track.base[-1])[:3, 3]
    return {
        "fell": float(virtual_robot.fallen),
        "right_%": 100.0 * np.mean(track.phase == true_phase[at]),
        "late_mean_ms": 1e3 * np.mean(np.abs(late)),
        "late_max_ms": 1e3 * np.max(np.abs(late)),
        "spurious": spurious,
        "missed": missed,
        "foot_changes": int(np.count_nonzero(np.diff(track.foot))),
        "drift_mm": 1e3 * float(np.hypot(*(guess - base[at[-1]])[:2])),
    }


def swings(lift: Array, high: float = 0.010, low: float = 0.004) -> list[tuple[int, int]]:
    """First and last sample of each excursion above `low` that reaches `high`."""
    above = lift > low
    edges = np.flatnonzero(np.diff(np.concatenate([[False], above, [False]]).astype(int)))
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if lift[a:b].max() > high]


def recorded(path: Path, config: Config) -> dict[str, float]:
    """Judges a recording by the motion of its feet and, where there is one, by its base pose."""
    with Bag(path) as bag:
        robot = find_robot(config, bag, TopicNames())
        joiner, samples, poses = Joiner(robot, config, stream_delays(build_effects(config.effects, robot)[0])), [], []
        for topic, _, message in bag.messages([JOINTS, LEFT, RIGHT, TRUE_BASE]):
            if topic == JOINTS:
                samples += joiner.add_joint(joint_from(message))
            elif topic == TRUE_BASE:
                p, o = message.pose.position, message.pose.orientation
                stamp = message.header.stamp
                poses.append((stamp.sec * 10**9 + stamp.nanosec, p.x, p.y, p.z, o.x, o.y, o.z, o.w))
            else:
                samples += joiner.add_wrench(Foot.LEFT if topic == LEFT else Foot.RIGHT, wrench_from(message))
        samples += joiner.flush()
    start_ns = samples[0].stamp_ns
    track = follow(robot, config, samples, start_ns)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(track.phase)) + 1, [len(track.t)]])
    parts = [(int(track.phase[a]), a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    print("  " + " ".join(f"{Phase(p).name[0]}{track.t[b - 1] - track.t[a]:.2f}" for p, a, b in parts))
    result: dict[str, float] = {
        "samples": len(samples),
        "shortest_s": min((track.t[b - 1] - track.t[a] for _, a, b in parts), default=0.0),
        "flight": sum(p == Phase.FLIGHT for p, _, _ in parts),
        "foot_changes": int(np.count_nonzero(np.diff(track.foot))),
    }
    for phase, lift in ((Phase.LEFT, track.lift), (Phase.RIGHT, -track.lift)):
        moves = swings(lift)
        alone = [(a, b) for p, a, b in parts if p == phase]
        hits = [sum(a < d and c < b for c, d in moves) for a, b in alone]
        result[f"swings_{Foot(int(phase)).other.name.lower()}"] = len(moves)
        result[f"matched_{Foot(int(phase)).other.name.lower()}"] = sum(hit == 1 for hit in hits)
    if poses:
        result |= drift(track, np.array(poses), start_ns)
    return result


def drift(track: Track, poses: Array, start_ns: int) -> dict[str, float]:
    """Error of the base in odom against motion capture (n, 8), both aligned at the start in x, y and yaw."""
    t = (poses[:, 0] - start_ns) * 1e-9
    true = np.stack([np.interp(track.t, t, poses[:, i]) for i in (1, 2)], axis=1)
    turn = np.unwrap(Rotation.from_quat(poses[:, 4:]).as_euler("ZYX")[:, 0])
    true_yaw = np.interp(track.t, t, turn)
    yaw = np.unwrap(np.arctan2(track.base[:, 1, 0], track.base[:, 0, 0]))
    offset = true_yaw[0] - yaw[0]
    c, s = np.cos(offset), np.sin(offset)
    found = (track.base[:, :2, 3] - track.base[0, :2, 3]) @ np.array([[c, s], [-s, c]]) + true[0]
    error = np.hypot(*(found - true).T)
    path = np.hypot(*np.diff(true[::20], axis=0).T).sum()  # 0.2 s apart: the noise of the capture adds no way
    yaw_error = np.degrees(np.abs(yaw + offset - true_yaw))
    return {
        "path_m": path,
        "drift_end_m": error[-1],
        "drift_end_%": 100 * error[-1] / path,
        "drift_max_m": error.max(),
        "yaw_end_deg": yaw_error[-1],
        "yaw_max_deg": yaw_error.max(),
    }


def show(name: str, result: dict[str, float]) -> None:
    """One row of the table."""
    print(f"{name:16s}" + "  ".join(f"{key} {value:.4g}" for key, value in result.items()), flush=True)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="*", type=Path)
    parser.add_argument("--config", type=Path, default=None)
    parser.add_argument("--seeds", type=int, default=2, help="runs of each gait of the virtual robot")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=200.0, help="of the virtual robot's sensors [Hz]")
    parser.add_argument("--bias", type=float, default=1.5, help="of the vertical forces, one standard deviation [N]")
    options = parser.parse_args()
    config = load_config(options.config or config_path())
    for path in options.bags:
        show(path.name, recorded(path, config))
    if options.bags:
        return
    sensors = SensorOptions()
    sensors = replace(sensors, rate_hz=options.rate, force_bias=(*sensors.force_bias[:2], options.bias))
    for name in ("test1", "test2"):
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            show(f"{name} seed {seed}", virtual(name, seed, config, sensors))


if __name__ == "__main__":
    main()
