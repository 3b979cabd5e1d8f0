# SPDX-License-Identifier: BSD-3-Clause
"""A link encoder whose zero is off."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect
from .unknown import About, Unknown, columns_minus

if TYPE_CHECKING:
    from ..base.types import Sample


class EncoderBias(Effect):
    """The link encoder reads true angle + bias, which is taken off again. The motor side has its own encoder."""

    name: ClassVar[str] = "encoder_bias"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("bias", "float", 0.0, "rad", "what the link encoder reads too much", -0.3, 0.3),
    )
    sentence: ClassVar[str] = "the link encoder of {at} reads {bias_size} too high"
    opposite: ClassVar[str] = "the link encoder of {at} reads {bias_size} too low"
    experiment: ClassVar[str] = "the joint against a mechanical stop, or in a gauge of known angle"
    exact: ClassVar[bool] = True

    def correct(self, sample: Sample) -> None:
        sample.q[self.joints] -= self.values["bias"]

    @classmethod
    def unknowns(cls, about: About) -> list[Unknown]:
        prior = about.widths("encoder_bias.bias", "spread", "reach")
        return [cls.unknown("bias", columns_minus("q", j), joint, **prior) for joint, j in about.joints.items()]
