# SPDX-License-Identifier: BSD-3-Clause
"""Online prediction of the centre of mass of a compliant humanoid.

The names below are the public interface; what is not among them may change at any time. Importing the package is
cheap: the model, and with it numba and Pinocchio, is loaded when the first of the names is used.

    import coman_reduced_model as coman

    config = coman.load_config("coman.yaml")
    for prediction in coman.predict("bag", config):
        print(prediction.stamp_ns, prediction.measured_com, prediction.predicted_com)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .diagnose import diagnose  # first: the function of this name, not the sub-package, is what `diagnose` means here

if TYPE_CHECKING:
    from .api import (
        ComanError,
        Config,
        Flags,
        Foot,
        ImuMessage,
        JointMessage,
        Phase,
        Pipeline,
        Prediction,
        Predictor,
        Reference,
        Robot,
        Sample,
        Session,
        TopicNames,
        WrenchMessage,
        bag_path,
        config_path,
        open_robot,
        predict,
        read_result,
        save_config,
    )
    from .core.config.files import load_config
    from .diagnose.report.folder import save_diagnosis
    from .diagnose.result import Diagnosis

    __version__: str

__all__ = [
    # configurations and robots
    "Config",
    "Robot",
    "config_path",
    "load_config",
    "open_robot",
    "save_config",
    # recordings
    "Session",
    "TopicNames",
    "bag_path",
    "predict",
    # streams
    "Pipeline",
    "Predictor",
    # diagnosis
    "Diagnosis",
    "diagnose",
    "save_diagnosis",
    # results
    "read_result",
    # data
    "Flags",
    "Foot",
    "ImuMessage",
    "JointMessage",
    "Phase",
    "Prediction",
    "Reference",
    "Sample",
    "WrenchMessage",
    # errors
    "ComanError",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module(".resources", __name__).version()
    if name in __all__:
        return getattr(import_module(".api", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
