# SPDX-License-Identifier: BSD-3-Clause
"""The discrepancy workflow: where simulation and measurement disagree, and which effect is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # as the package loads this module, it must cost nothing
    from ..core.config.schema import Config
    from ..progress import Progress
    from ..topics import TopicNames
    from .result import Diagnosis


def diagnose(
    bags: str | Path | Sequence[str | Path],
    holdout: str | Path | Sequence[str | Path] = (),
    config: Config | None = None,
    *,
    assume: Sequence[str] = (),
    baseline: str | Path = "",
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    progress: Progress | None = None,
    notice: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find the effect that the model or the sensors lack in recorded walks of one robot.

    Takes some ten seconds a bag and a second process; a script that calls this needs the usual
    `if __name__ == "__main__":` of programs with several processes.

    Args:
        bags: recordings to find effects in.
        holdout: other recordings, better of another gait; nothing is fitted to them. The last one confirms: it is
            opened once, at the end, and can only take effects away; the weight of the robot counts all. Those before it
            help to choose.
        config: nominal robot and model; default: COMAN.
        assume: effects whose parameters are fitted instead of looking for one: `NAME` or `NAME:where=PLACE`.
        baseline: file of what is usual for this robot (`coman baseline`); default: the shipped population.
        urdf: file of the robot, instead of the one that configuration or bag name.
        names: namespace and remappings of the topics.
        progress: called with the fraction done and what is being done.
        notice: called before the search, with each stream whose clock is apart.

    Raises:
        ComanError: a bag, the robot or the configuration cannot be used.

    Example:
        >>> import coman_reduced_model as coman
        >>> diagnosis = coman.diagnose(coman.bag_path("test1"), holdout=coman.bag_path("test2"))
        >>> diagnosis.verdict
        'none'
        >>> coman.save_diagnosis(diagnosis, "diagnosis")  # diagnosis.json, model.yaml, report.html
    """
    from ..core.config.schema import Config
    from .workflow import diagnose

    train, held = ([each] if isinstance(each, (str, Path)) else each for each in (bags, holdout))
    return diagnose(
        train,
        held,
        config or Config(),
        urdf=urdf,
        names=names,
        assume=assume,
        baseline=baseline,
        progress=progress,
        notice=notice,
    )
