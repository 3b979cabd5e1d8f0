# SPDX-License-Identifier: BSD-3-Clause
"""Level and noise of each channel in one kind of phase: a scalar Kalman filter and two tests, compiled.

A value is tested against zero, with the variance over nominal robots, and against the level of the phases before it.
In both tests two values in a row must agree in sign.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Record, Records, compiled
from ..base.types import Array
from .laws import PhaseMean

_MIN_PHASES = 2  # of which a level is made before values are tested against it
_MEMORY = 20.0  # phases over which a level follows, and noise is known
_PRIOR_PHASES = 6.0  # phases that the nominal noise is worth
_STUDENT = 2.0  # extra variance while the noise is known from few phases
_DOUBTFUL = 2.5  # standard deviations beyond which a value is not learnt before the next one of its kind is known

# State of one channel in one kind of phase. Values have the unit of the channel, times are in s.
CHANNEL = np.dtype(
    [
        ("level", np.float64),
        ("level_variance", np.float64),
        ("level_phases", np.float64),  # of which the level is made
        ("level_load", np.float64),  # load offset (`PhaseMean`) of the level
        ("noise_variance", np.float64),  # from phase to phase
        ("noise_phases", np.float64),  # from which the noise is known
        ("pending", np.float64),  # contribution of the last value to the noise, if that value is doubtful
        # test against the level
        ("error", np.float64),  # of the last value
        ("error_sigma", np.float64),  # the same in standard deviations; NaN: not known
        ("change_sigma", np.float64),  # the weaker of the last two, with sign
        ("change_onset", np.float64),
        # test against zero
        ("offset_sign", np.float64),  # of the last value beyond the threshold
        ("offset_sigma", np.float64),  # of two values in a row beyond the threshold, in standard deviations
        ("offset", np.float64),
        ("offset_onset", np.float64),
        ("last_phase", np.float64),  # start of the last phase with a value
    ]
)


@compiled
def update_channels(
    channels: Records,
    mean: PhaseMean,
    comparable: NDArray[np.bool_],
    min_variance: Array,
    drift_variance: Array,
    threshold: float,
    start: float,
) -> None:
    """Test the mean of a phase, and learn from it.

    Args:
        channels: `CHANNEL` (n,), updated.
        mean: of the phase.
        comparable: (n,) channels to be tested against their level; the others are tested against zero alone.
        min_variance: (n,) lower bound of the noise.
        drift_variance: (n,) of the level, from phase to phase.
        threshold: standard deviations.
        start: of the phase [s].
    """
    for i in range(channels.shape[0]):
        channel, value = channels[i], mean.values[i]
        if np.isnan(value):
            continue
        channel.last_phase = start
        if mean.variance[i] > 0.0:
            _test_against_zero(channel, value, mean.variance[i], threshold, start)
        if not comparable[i]:
            continue
        if channel.level_phases == 0.0:
            channel.level, channel.level_load, channel.level_phases = value, mean.load_offset[i], 1.0
            channel.level_variance = channel.noise_variance * (1.0 + 1.0 / _MEMORY**2) + drift_variance[i]
        else:
            load_change = mean.load_offset[i] - channel.level_load
            doubtful = _test_against_level(channel, value, load_change**2, threshold, start, min_variance[i])
            _learn_level(channel, doubtful, load_change, drift_variance[i])


@compiled
def _test_against_zero(channel: Record, value: float, variance: float, threshold: float, start: float) -> None:
    """Variance: over nominal robots."""
    sigma = value / np.sqrt(variance + channel.noise_variance)
    sign = np.sign(sigma) if abs(sigma) > threshold else 0.0
    if sign != 0.0 and sign == channel.offset_sign:
        channel.offset_sigma, channel.offset = sigma, value
    elif abs(sigma) < 0.5 * threshold or sigma * channel.offset_sigma < 0.0:
        channel.offset_sigma = 0.0
    if sign != channel.offset_sign and channel.offset_sigma == 0.0:
        channel.offset_onset = start
    channel.offset_sign = sign


@compiled
def _test_against_level(
    channel: Record, value: float, load_variance: float, threshold: float, start: float, min_variance: float
) -> bool:
    """Compare with the level, and learn the noise; whether the value is too doubtful to be learnt as a level."""
    channel.error = value - channel.level
    student = 1.0 + _STUDENT / (1.0 + channel.noise_phases)
    variance = (channel.level_variance + channel.noise_variance) * student
    sigma = channel.error / np.sqrt(variance + load_variance)
    # Under another load, little is learnt of noise and level.
    excess = (min(abs(sigma), threshold) ** 2 - 1.0) * variance / (variance + load_variance)
    earlier, doubtful = channel.pending, False  # contribution of the last value, if it was noise
    if channel.level_phases >= _MIN_PHASES:
        last = channel.error_sigma
        same_sign = sigma * last > 0.0
        channel.change_sigma = np.sign(sigma) * min(abs(sigma), abs(last)) if same_sign else 0.0
        if abs(sigma) > 1.0 and not (same_sign and abs(last) > 1.0):
            channel.change_onset = start
        channel.error_sigma, doubtful = sigma, abs(sigma) > _DOUBTFUL
        channel.pending = 0.0
        if doubtful:
            channel.pending = excess
            if same_sign:
                earlier = 0.0  # it was no noise
            excess = 0.0
    if not doubtful:
        channel.noise_phases += 1.0
    if not doubtful or earlier > 0.0:
        share = (excess + earlier) / (_PRIOR_PHASES + min(channel.noise_phases, _MEMORY))
        channel.noise_variance = max(min_variance, channel.noise_variance * (1.0 + share))
    return doubtful


@compiled
def _learn_level(channel: Record, doubtful: bool, load_change: float, drift_variance: float) -> None:
    """Kalman update of the level; a doubtful value only adds the drift."""
    if doubtful:
        channel.level_variance += drift_variance
        return
    noise = channel.noise_variance
    variance = noise + load_change**2
    gain = channel.level_variance / (channel.level_variance + variance)
    channel.level += gain * channel.error
    channel.level_load += gain * load_change
    channel.level_variance = gain * variance + noise / _MEMORY**2 + drift_variance
    channel.level_phases += 1.0
