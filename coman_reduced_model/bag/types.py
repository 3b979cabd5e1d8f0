# SPDX-License-Identifier: BSD-3-Clause
"""Message definitions for bags: those of ROS 2 Jazzy and our own, without ROS installed."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..messages import OWN, MessageTypes
from ..resources import share_path


@cache
def typestore() -> Typestore:
    """The definitions of Jazzy's common interfaces and of coman_reduced_model_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    definitions: dict[str, Any] = {}
    for path in sorted((share_path() / "msg_defs" / "msg").glob("*.msg")):
        definitions.update(get_types_from_msg(path.read_text(encoding="utf-8"), f"{OWN}/msg/{path.stem}"))
    store.register(definitions)
    return store


@cache
def bag_types() -> MessageTypes:
    """Message classes to make what a bag takes (messages.prediction_to and the like)."""
    return MessageTypes(lambda name: typestore().types[name], lambda values: values)
