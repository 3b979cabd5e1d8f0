# SPDX-License-Identifier: BSD-3-Clause
"""A recording in the Rerun viewer: robot, COM with its trail, soles, predictions ahead and residuals over time.

Rerun (https://rerun.io) is optional: nothing is imported of it before it is asked for.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..bag.session import Session
from ..core.base.pose import quaternion
from ..core.base.throttle import Throttle
from ..core.base.types import Array, Foot, Prediction, Sample
from ..core.evaluation.statistics import AXES
from ..core.robot.links import Links
from ..errors import ComanError
from ..messages import ODOM
from ..progress import Progress

_RATE = 50.0  # [Hz] of what is drawn in space; plots have every sample
_TRAIL_S = 3.0
_COLORS = {"measured": (31, 119, 180), "predicted": (255, 127, 14)}
_LOADED, _FREE = (0, 158, 115), (150, 150, 150)
_FEET = {Foot.LEFT: "left", Foot.RIGHT: "right"}
_PLOTS = {  # entity: title, what is plotted of a prediction (3,) [mm]
    "residual": ("measured - predicted [mm]", lambda p: 1e3 * p.residual),
    "rigid": ("measured - reference (rigid robot) [mm]", lambda p: 1e3 * (p.measured_com - p.reference_com)),
}  # fmt: skip


def rerun() -> ModuleType:
    """The module of Rerun.

    Raises:
        ComanError: it is not installed.
    """
    os.environ.setdefault("RUST_LOG", "error")  # else it lists every mesh that is not at hand
    try:
        import rerun
    except ImportError:
        raise ComanError('the viewer is not installed: pip install "rerun-sdk>=0.41"') from None
    return rerun


def write_view(session: Session, path: Path, progress: Progress | None = None) -> int:
    """Predict an open bag and write what there is to see into an .rrd file, whole or not at all.

    Returns:
        The number of samples.

    Raises:
        ComanError: Rerun is not installed, the bag cannot be used, or the file cannot be written.
    """
    rr = rerun()
    recording = rr.RecordingStream(f"coman {session.bag.path.name}")
    part = path.with_name(f".{path.name}.part")
    try:
        recording.save(part, default_blueprint=_blueprint(rr, session))
    except Exception as error:
        raise ComanError(f"{path}: cannot be written: {' '.join(str(error).split())}") from None
    try:
        scene = _Scene(rr, recording, session)
        for sample, prediction in session.predicted(progress):
            scene.add(sample, prediction)
        scene.finish()
        recording.disconnect()
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return len(scene.times)


def open_view(path: Path) -> None:
    """Show an .rrd file until the viewer is closed; Rerun's collecting of usage data is off in it.

    Raises:
        ComanError: the viewer cannot be started.
    """
    rerun()
    viewer = [sys.executable, "-m", "rerun"]  # the command may not be on the path
    with tempfile.TemporaryDirectory(prefix="coman-view-") as settings:
        # Settings of its own, in which usage data are switched off: those of the user are left as they are.
        environment = {**os.environ, "XDG_CONFIG_HOME": settings}
        try:
            subprocess.run([*viewer, "analytics", "disable"], env=environment, check=True, capture_output=True)
            ended = subprocess.run([*viewer, str(path)], env=environment, check=False)
        except (OSError, subprocess.CalledProcessError) as error:
            raise ComanError(f"the viewer cannot be started: {error}") from None
    if ended.returncode:
        raise ComanError(f"the viewer ended with exit code {ended.returncode} (no display? --out writes a file)")


class _Scene:
    """What is logged of a recording; all places in `odom`."""

    def __init__(self, rr: ModuleType, recording: Any, session: Session) -> None:
        self._rr, self._log = rr, recording.log
        self._recording, self._first_ns = recording, 0
        self._root, self._links = session.robot.root, Links(session.robot)
        self._every = Throttle(_RATE)
        self._last: dict[str, Array] = {}
        self._foot: Foot | None = None
        self.times: list[float] = []
        self._plotted: dict[str, list[Array]] = {name: [] for name in _PLOTS}
        self._shares: list[float] = []
        self._describe(session)

    def _describe(self, session: Session) -> None:
        """What does not change: shapes of the links and soles, names and colours."""
        rr, static = self._rr, {"static": True}
        for name in ("com/horizon", *(f"{kind}/{which}" for kind in ("com", "trail") for which in _COLORS)):
            self._log(name, rr.CoordinateFrame(ODOM), **static)
        with tempfile.TemporaryDirectory() as folder:
            urdf = Path(folder) / "robot.urdf"
            urdf.write_text(session.robot.urdf, encoding="utf-8")
            tree = rr.urdf.UrdfTree.from_file_path(urdf, entity_path_prefix="robot")
            tree.log_urdf_to_recording(self._recording)
        self._draw_skeleton(session)
        for foot, leg in ((Foot.LEFT, session.config.robot.left), (Foot.RIGHT, session.config.robot.right)):
            back, front, right, left = session.robot.soles[foot]
            box = rr.Boxes3D(
                mins=[[back, right, -0.004]], sizes=[[front - back, left - right, 0.004]], fill_mode="solid"
            )
            self._log(f"soles/{_FEET[foot]}", rr.CoordinateFrame(leg.sole_frame), box, **static)
        for name in _PLOTS:
            self._log(
                name, rr.SeriesLines(names=list(AXES), colors=[(213, 94, 0), (0, 114, 178), (0, 158, 115)]), **static
            )
        self._log("left_share", rr.SeriesLines(names=["share of the left foot"]), **static)

    def _draw_skeleton(self, session: Session) -> None:
        """A line from each link to those that hang on it: all that is seen of meshes that are not at hand."""
        at_zero = self._links.poses(np.zeros(len(session.robot.joint_names)))
        links = [(*names, pose) for names, pose in zip(self._links.moving, at_zero, strict=True)] + self._links.fixed
        for parent in sorted({parent for parent, _, _ in links}):
            strips = [[(0.0, 0.0, 0.0), pose[:3]] for above, _, pose in links if above == parent]
            lines = self._rr.LineStrips3D(strips, radii=0.004, colors=[_FREE])
            self._log(f"skeleton/{parent}", self._rr.CoordinateFrame(parent), lines, static=True)

    def _place(self, parent: str, child: str, pose: Any) -> None:
        transform = self._rr.Transform3D(
            translation=pose[:3], quaternion=pose[3:], parent_frame=parent, child_frame=child
        )
        self._log(f"tf/{child}", transform)

    def add(self, sample: Sample, prediction: Prediction) -> None:
        """One sample."""
        self._first_ns = self._first_ns or prediction.stamp_ns  # log times may be of another clock
        self.times.append((prediction.stamp_ns - self._first_ns) * 1e-9)
        for name, (_, of) in _PLOTS.items():
            self._plotted[name].append(of(prediction))
        self._shares.append(prediction.support.left_share)
        if self._every.due(prediction.stamp_ns) and np.isfinite(prediction.base_in_sole[0, 0]):
            self._recording.set_time("time", duration=self.times[-1])
            self._draw_robot(sample, prediction)
            self._draw_com(prediction)

    def _draw_robot(self, sample: Sample, prediction: Prediction) -> None:
        T = prediction.T_odom_base
        self._place(ODOM, self._root, (*T[:3, 3], *quaternion(T[:3, :3])))
        for (parent, child), pose in zip(self._links.moving, self._links.poses(sample.q), strict=True):
            self._place(parent, child, pose)
        support = prediction.support
        if support.support_foot != self._foot:
            self._foot = support.support_foot
            for foot, name in _FEET.items():
                color = _LOADED if foot == self._foot else _FREE
                self._log(f"soles/{name}", self._rr.Boxes3D.from_fields(colors=[color]))

    def _draw_com(self, prediction: Prediction) -> None:
        T, rr = prediction.T_odom_sole, self._rr
        for name, com in (("measured", prediction.measured_com), ("predicted", prediction.predicted_com)):
            if not np.isfinite(com).all():
                if self._last.pop(name, None) is not None:
                    self._log(f"com/{name}", rr.Clear(recursive=False))
                continue
            point, color = T[:3, :3] @ com + T[:3, 3], _COLORS[name]
            self._log(f"com/{name}", rr.Points3D([point], radii=0.012, colors=[color]))
            strip = [self._last.get(name, point), point]
            self._log(f"trail/{name}", rr.LineStrips3D([strip], radii=0.002, colors=[color]))
            self._last[name] = point
        ahead = [prediction.measured_com, *(each.com for each in prediction.horizons)]
        points = [T[:3, :3] @ p + T[:3, 3] for p in ahead if np.isfinite(p).all()]
        self._log("com/horizon", rr.LineStrips3D([points], radii=0.003, colors=[(204, 121, 167)]))

    def finish(self) -> None:
        """The plots, with every sample."""
        rr, send = self._rr, self._recording.send_columns
        times = rr.TimeColumn("time", duration=self.times)
        for name, values in self._plotted.items():
            send(name, [times], rr.Scalars.columns(scalars=np.array(values).reshape(-1, 3)))
        send("left_share", [times], rr.Scalars.columns(scalars=np.array(self._shares)))


def _blueprint(rr: ModuleType, session: Session) -> Any:
    """Robot on the left, plots on the right."""
    import rerun.blueprint as rrb

    trail = rrb.VisibleTimeRanges(
        timeline="time",
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_TRAIL_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    far = 2.5 * float(np.linalg.norm(session.robot.posture().p[Foot.LEFT]))  # from the leg
    space = rrb.Spatial3DView(
        name="robot",
        spatial_information=rrb.SpatialInformation(target_frame=ODOM),
        overrides={f"trail/{name}": trail for name in _COLORS},
        eye_controls=rrb.EyeControls3D(position=(far, -far, 0.6 * far), look_target=(0.0, 0.0, 0.2 * far)),
        line_grid=rrb.LineGrid3D(spacing=0.1),
    )
    plots = [rrb.TimeSeriesView(name=title, origin=name) for name, (title, _) in _PLOTS.items()]
    share = rrb.TimeSeriesView(name="share of the weight on the left foot", origin="left_share")
    return rrb.Blueprint(
        rrb.Horizontal(space, rrb.Vertical(*plots, share), column_shares=[3, 2]), rrb.SelectionPanel(state="hidden")
    )
