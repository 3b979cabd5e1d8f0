# SPDX-License-Identifier: BSD-3-Clause
"""A run of the predictor from the bag of its predictions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ..bag.reader import Bag
from ..core.evaluation.run import Run, run_of_rows
from ..errors import BagError
from ..messages import COM_PREDICTION, matrix_from, stamp_of


def load_run(path: Path, progress: Callable[[float, str], None] | None = None) -> Run:
    """The run that a bag with a com/prediction topic holds, whatever its namespace.

    Raises:
        BagError: it cannot be read or has no such topic.
    """

    def rows(bag: Bag, topic: str) -> Iterable[tuple[Any, ...]]:
        total = max(bag.counts[topic], 1)
        for count, (_, _, m) in enumerate(bag.messages([topic])):
            if progress is not None and not count % 1000:
                progress(count / total, "reading the predictions")
            s = m.support
            yield (
                stamp_of(m.header), m.header.frame_id, s.phase, s.support_foot, s.left_share, m.flags,
                _xyz(m.measured_position), _xyz(m.reference_position), _xyz(m.predicted_position),
                matrix_from(m.sole_pose),
            )  # fmt: skip

    with Bag(path) as bag:
        topics = [topic for topic, kind in bag.topics.items() if kind == COM_PREDICTION]
        if len(topics) != 1:
            found = ", ".join(topics) or "none"
            raise BagError(f"{path}: wanted one topic of type {COM_PREDICTION}, found {found}")
        return run_of_rows(rows(bag, topics[0]))


def _xyz(point: Any) -> tuple[float, float, float]:
    return point.x, point.y, point.z
