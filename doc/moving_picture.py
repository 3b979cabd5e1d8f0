# SPDX-License-Identifier: BSD-3-Clause
"""The moving picture of the README: a recorded walk, its measured and predicted COM. `python doc/moving_picture.py`."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import coman_reduced_model as coman
from coman_reduced_model.core.base.types import Array
from coman_reduced_model.core.robot.links import Links

OUT = Path(__file__).parent / "results" / "walk.gif"
FROM_S, TO_S, RATE = 4.4, 8.6, 20.0  # of the recording: three strides; pictures a second, shown at half speed
SHOWN_S = 2.1  # length of the plots' window
MEASURED, PREDICTED, RIGID, BODY = "#1a1c21", "#d55e00", "#0072b2", "#c9d3df"
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def pose(position: Array, turn: Rotation) -> Array:
    """(4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), position
    return T


def boxes(urdf: str) -> dict[str, Array]:
    """Corners (4, 8) of the box of each link that has one, in its frame [m]."""
    found = {}
    for link in ElementTree.fromstring(urdf).iterfind("link"):
        visual, box = link.find("visual/origin"), link.find("visual/geometry/box")
        if visual is not None and box is not None:
            xyz, rpy, size = (
                np.array(text.split(), dtype=float)
                for text in (visual.get("xyz", "0 0 0"), visual.get("rpy", "0 0 0"), box.get("size", ""))
            )
            corners = np.c_[_CORNERS * size, np.ones(8)].T
            found[str(link.get("name"))] = pose(xyz, Rotation.from_euler("xyz", rpy)) @ corners
    return found


def main() -> None:
    """Predict the bag and draw it."""
    times, bodies, coms, differences = [], [], [], []
    with coman.Session(coman.bag_path("test1")) as session:
        links, corners, root = Links(session.robot), boxes(session.robot.urdf), session.robot.root
        for sample, p in session.predicted():
            time = (p.stamp_ns - session.bag.start_ns) * 1e-9
            if FROM_S - SHOWN_S <= time <= TO_S:
                placed = {root: p.T_odom_base}
                for (above, link), at in zip(links.moving, links.poses(sample.q), strict=True):
                    placed[link] = placed[above] @ pose(at[:3], Rotation.from_quat(at[3:]))
                times.append(time)
                bodies.append({link: (placed[link] @ box)[:3] for link, box in corners.items() if link in placed})
                coms.append(p.T_odom_sole[:3, :3] @ p.measured_com + p.T_odom_sole[:3, 3])
                differences.append(1e3 * (np.array((p.measured_com, p.predicted_com)) - p.reference_com))
    shots = np.searchsorted(times, np.arange(FROM_S, TO_S, 1.0 / RATE))
    pictures = [shot(int(i), np.array(times), bodies, np.array(coms), np.array(differences)) for i in shots]
    palette = pictures[0].quantize(64)
    drawn = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    drawn[0].save(OUT, save_all=True, append_images=drawn[1:], duration=2000 / RATE, loop=0, optimize=True)
    print(f"written: {OUT.name}, {OUT.stat().st_size / 1e3:.0f} kB, {len(drawn)} pictures", file=sys.stderr)


def shot(now: int, times: Array, bodies: list[dict[str, Array]], coms: Array, differences: Array) -> Image.Image:
    """One picture: robot from its right side, and how far its COM is from that of a rigid robot."""
    figure = Figure(figsize=(8.4, 3.6), dpi=100, facecolor="white", layout="constrained")
    left, right = figure.add_gridspec(1, 2, width_ratios=(1, 1.9))
    draw_robot(figure.add_subplot(left), bodies[now], coms[: now + 1])
    plots = right.subgridspec(2, 1)
    window = slice(np.searchsorted(times, times[now] - SHOWN_S), now + 1)
    for row, (axis, name) in enumerate(((0, "forward"), (2, "up"))):
        ax = figure.add_subplot(plots[row])
        span = times[window] - times[now]
        for values, color, label, width in (
            (differences[:, 0, axis], MEASURED, "measured", 2.4),
            (differences[:, 1, axis], PREDICTED, "predicted", 1.2),
        ):
            line = values[window].copy()
            # Broken where the support sole, and with it the reference, changes.
            line[1:][np.abs(np.diff(values[window])) > 0.8] = np.nan
            ax.plot(span, line, color=color, linewidth=width, label=label)
        ax.axhline(0.0, color=RIGID, linestyle=":", label="rigid robot")
        ax.set(xlim=(-SHOWN_S, 0.0), ylim=(-5.0, 3.5) if axis == 0 else (-4.0, 1.0))
        ax.set_title(f"COM against that of a rigid robot, {name} [mm]", loc="left", fontsize=10)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=8)
        if row == 0:
            ax.legend(loc="upper left", ncols=3, fontsize=8, frameon=False)
            ax.set_xticklabels([])
        else:
            ax.set_xlabel("time [s]", fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return Image.open(buffer).convert("RGB")


def draw_robot(ax: Axes, body: dict[str, Array], coms: Array) -> None:
    """Boxes of the links from the robot's right side, far ones first, the floor, and the COM with its trail."""
    for points in sorted(body.values(), key=lambda points: -points[1].mean()):
        flat = points[[0, 2]].T
        outline = flat[ConvexHull(flat).vertices]
        ax.add_patch(Polygon(outline, facecolor=BODY, edgecolor="#5b606b", linewidth=0.8))
    ax.axhline(0.0, color="#5b606b", linewidth=1.0)
    ax.plot(coms[:, 0], coms[:, 2], color=MEASURED, linewidth=1.0)
    ax.plot(coms[-1, 0], coms[-1, 2], "o", color=PREDICTED, markersize=9, markeredgecolor=MEASURED)
    middle = coms[-1, 0]
    ax.set(xlim=(middle - 0.27, middle + 0.27), ylim=(-0.03, 0.72), aspect="equal")
    ax.axis("off")
    for x in np.arange(np.ceil((middle - 0.27) * 10) / 10, middle + 0.27, 0.1):
        ax.plot([x, x], [-0.02, 0.0], color="#5b606b", linewidth=1.0)


if __name__ == "__main__":
    main()
