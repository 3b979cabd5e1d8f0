# SPDX-License-Identifier: BSD-3-Clause
"""Which streams the predictions need beside the joint states."""

from __future__ import annotations

from ..base.stream_names import CONTACTS, MOTORS, REFERENCE, WRENCHES
from ..base.types import Foot
from ..config.schema import Config

_WRENCHES = {WRENCHES[Foot.LEFT]: "left_wrench", WRENCHES[Foot.RIGHT]: "right_wrench"}
_GROUND = {"sensors": _WRENCHES, "torques": {}, "contacts": {CONTACTS: "contacts"}}  # by streams.wrench_source
_REFERENCES = {"motor": {MOTORS: "motor_q"}, "topic": {REFERENCE: "reference"}, "none": {}}


def expected_streams(config: Config) -> dict[str, str]:
    """The field of Sample that each of them fills, by stream."""
    return {**_GROUND[config.streams.wrench_source], **_REFERENCES[config.prediction.reference]}


def why_expected(stream: str, config: Config) -> str:
    """The parameter because of which a stream is needed, and what does without."""
    if stream in _WRENCHES:
        return "streams.wrench_source: sensors; `torques` and `contacts` do without"
    if stream == CONTACTS:
        return "streams.wrench_source: contacts; `torques` and `sensors` do without"
    if stream in (MOTORS, REFERENCE):
        return f"prediction.reference: {config.prediction.reference}; `none` does without"
    return ""
