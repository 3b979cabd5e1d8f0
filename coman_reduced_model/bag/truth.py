# SPDX-License-Identifier: BSD-3-Clause
"""The truth beside the bag of a virtual robot, BAG.truth.npz: only what is predicted is judged by it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.base.pose import LEVEL
from ..core.base.types import Foot
from ..core.evaluation.consistency import TrueMotion


def true_motion(bag: str | Path) -> TrueMotion | None:
    """How the COM of a recorded bag moved in truth; None: nobody knows, or the file is none of `coman record`."""
    path = Path(f"{Path(bag)}.truth.npz")
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            stamps, com = file["stamp_ns"], file["com"]
            poses = {Foot.LEFT: file["T_left"], Foot.RIGHT: file["T_right"]}
            trunk = file.get("base_orientation"), file.get("gravity", LEVEL)  # of files without it, level ground
    except Exception:  # a damaged archive fails in any way
        return None
    n = len(stamps)
    shapes = com.shape == (n, 3) and all(T.shape == (n, 4, 4) for T in poses.values())
    if n < 2 or not shapes:
        return None
    turned = trunk if trunk[0] is not None and trunk[0].shape == (n, 4) and trunk[1].shape == (3,) else None
    return TrueMotion.of(stamps, com, poses, turned)
