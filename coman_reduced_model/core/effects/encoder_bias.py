# SPDX-License-Identifier: BSD-3-Clause
"""A link encoder whose zero is off."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from ..base.parameter import Parameter
from .base import Effect

if TYPE_CHECKING:
    from ..base.types import Sample


class EncoderBias(Effect):
    """The link encoder reads true angle + bias, which is taken off again. The motor side has its own encoder."""

    name: ClassVar[str] = "encoder_bias"
    place: ClassVar[str] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("bias", "float", 0.0, "rad", "what the link encoder reads too much", -0.3, 0.3),
    )

    def correct(self, sample: Sample) -> None:
        sample.q[self.joints] -= self.values["bias"]
