# SPDX-License-Identifier: BSD-3-Clause
"""The public interface in one place; users take it from the package itself, which loads this when it is needed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .bag.reader import Bag
from .bag.session import Session, find_robot, read_urdf
from .core.base.types import (
    Flags,
    Foot,
    ImuMessage,
    JointMessage,
    Phase,
    Prediction,
    Reference,
    Sample,
    WrenchMessage,
)
from .core.config.files import load_config, save_config
from .core.config.schema import Config
from .core.pipeline import Pipeline
from .core.predictor import Predictor
from .core.robot.robot import Robot
from .errors import ComanError
from .progress import Progress
from .resources import bag_path, config_path
from .schemas import read_result
from .topics import TopicNames

if TYPE_CHECKING:
    from .diagnose.report.folder import save_diagnosis
    from .diagnose.result import Diagnosis

__all__ = [
    "ComanError",
    "Config",
    "Diagnosis",
    "Flags",
    "Foot",
    "ImuMessage",
    "JointMessage",
    "Phase",
    "Pipeline",
    "Prediction",
    "Predictor",
    "Reference",
    "Robot",
    "Sample",
    "Session",
    "TopicNames",
    "WrenchMessage",
    "bag_path",
    "config_path",
    "load_config",
    "open_robot",
    "predict",
    "read_result",
    "save_config",
    "save_diagnosis",
]


def open_robot(source: str | Path, config: Config | None = None, *, names: TopicNames | None = None) -> Robot:
    """The robot of a URDF or of a recording.

    Args:
        source: URDF as text, a URDF file (.urdf, .xml), or a bag, which describes its robot unless the configuration
            names a URDF.
        config: which links and joints are the legs; default: those of COMAN.
        names: namespace and remappings of the bag's topics.

    Raises:
        ComanError: there is no URDF, or the legs are not in it.

    Example:
        >>> import coman_reduced_model as coman
        >>> robot = coman.open_robot(coman.bag_path("test1"))
        >>> print(f"{robot.mass:.1f} kg, {len(robot.joint_names)} joints")
        17.3 kg, 12 joints
    """
    config = config or Config()
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return Robot(source, config.robot, "URDF")
    path = Path(source)
    if path.suffix in (".urdf", ".xml"):
        return Robot(read_urdf(path), config.robot, str(path))
    with Bag(path) as bag:
        return find_robot(config, bag, names or TopicNames())


def predict(
    bag: str | Path,
    config: Config | None = None,
    *,
    urdf: str | Path | None = None,
    names: TopicNames | None = None,
    progress: Progress | None = None,
) -> Iterator[Prediction]:
    """Predict a recording, joint state by joint state; the bag is read as the iteration goes on, never as a whole.

    These are the predictions that the node publishes for the same messages. Where the counters and warnings are of
    interest as well, use a `Session`.

    Args:
        bag: folder of a rosbag2 recording, or one of its files.
        config: robot, streams and model; default: COMAN with the standard model.
        urdf: file of the robot, instead of the one that configuration or bag name.
        names: namespace and remappings of the topics.
        progress: called with the fraction done and what is being done.

    Raises:
        ComanError: the bag, the robot or the configuration cannot be used; when the first prediction is asked for.

    Example:
        >>> import coman_reduced_model as coman
        >>> for prediction in coman.predict(coman.bag_path("test1")):
        ...     if prediction.support.phase == coman.Phase.LEFT:
        ...         break
        >>> prediction.frame_id
        'l_sole'
        >>> float(abs(prediction.residual).max()) < 0.01  # measured minus predicted COM [m]
        True
    """
    with Session(bag, config, urdf=urdf, names=names) as session:
        yield from session.predictions(progress)


def __getattr__(name: str) -> Any:
    # These load scipy.optimize and matplotlib, which predictions do without.
    if name == "Diagnosis":
        from .diagnose.result import Diagnosis

        return Diagnosis
    if name == "save_diagnosis":
        from .diagnose.report.folder import save_diagnosis

        return save_diagnosis
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
