# SPDX-License-Identifier: BSD-3-Clause
"""Level and noise of each channel in one kind of phase: a scalar Kalman filter and two tests, compiled.

A value is tested against zero, with the variance over nominal robots, and against the level of the phases before it.
In both tests two values or more in a row must agree in sign.

How much a channel varies from phase to phase differs by a factor of ten from one robot to the next, and by less from
one channel of a law to another of the same robot. So its noise has a prior in two steps: the robot's factor on what is
usual for the law, learnt from all its channels of that law, and an inverse gamma distribution of the variance about it,
learnt from the channel alone. A deviation in units of that noise has Student's distribution; `as_normal` makes it a
normal one that is as unlikely, so that one threshold is the same for all channels and at all times.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Record, Records, compiled
from ..base.types import Array
from .laws import Laws, PhaseMean

_MIN_PHASES = 2  # of which a level is made before values are tested against it
_MEMORY = 20.0  # phases over which a level follows, and noise is known
_LAW_MEMORY = 200.0  # deviations over which the noise of a law is known
_MIN_NOISE = 0.3  # of the nominal noise: noise floor, no false alarms on noise-free sensors
_LONGEST_RUN = 6.0  # phases
_ALIKE = 0.3  # of one deviation, that the next one must be at least, and the other way round
_DOUBTFUL = 2.5  # standard deviations beyond which a value is not learnt before the next one of its kind is known
# Mean and variance of the logarithm of a squared normal deviate.
_LOG_MEAN, LOG_VARIANCE = -1.2704, 4.9348
LEAST_SCATTER = 0.05  # of the logarithm of the noise

# State of one channel in one kind of phase. Values have the unit of the channel, times are in s.
CHANNEL = np.dtype(
    [
        ("level", np.float64),
        ("level_share", np.float64),  # variance of the level, as a share of that of the noise
        ("level_phases", np.float64),  # of which the level is made
        ("level_load", np.float64),  # load (`PhaseMean`) of the level
        ("excess", np.float64),  # sum of squared deviations from phase to phase, in nominal variances
        ("noise_phases", np.float64),  # of which that sum is made
        ("pending", np.float64),  # contribution of the last value to it, if that value is doubtful
        # test against the level
        ("error", np.float64),  # of the last value
        ("error_sigma", np.float64),  # the same in standard deviations; NaN: not known
        ("run", np.float64),  # deviations in a row with the same sign; sum and largest of their magnitudes
        ("run_sum", np.float64),
        ("run_most", np.float64),
        ("change_sigma", np.float64),  # of that run, with sign
        ("change_onset", np.float64),
        # test against zero
        ("offset_sign", np.float64),  # of the last value beyond the threshold
        ("offset_sigma", np.float64),  # of two values in a row beyond the threshold, in standard deviations
        ("offset", np.float64),
        ("offset_onset", np.float64),
        ("last_phase", np.float64),  # start of the last phase with a value
    ]
)
# Noise of the channels of one law on this robot.
LAW = np.dtype(
    [
        ("logs", np.float64),  # sum of the logarithms of squared deviations, in nominal variances
        ("deviations", np.float64),  # of which that sum is made
        ("prior", np.float64),  # deviations that the population is worth
        ("alike", np.float64),  # degrees of freedom: how much the noise of its channels is alike
    ]
)


def degrees_of_freedom(scatter: Array) -> Array:
    """Of a variance whose square root has a logarithm with that standard deviation, about (trigamma inverted)."""
    y = 4.0 * np.maximum(scatter, LEAST_SCATTER) ** 2
    return np.asarray((1.0 + np.sqrt(1.0 + 2.0 * y)) / y)


def noise_by_law(laws: Laws) -> tuple[Records, NDArray[np.int64]]:
    """`LAW` of a robot about which nothing is known yet, and (n,) which of them each channel belongs to."""
    names = list(laws.nominal)
    out = np.zeros(len(names), dtype=LAW)
    by_robot, by_channel = np.array([(row.by_robot, row.by_channel) for row in laws.nominal.values()]).T
    out["alike"] = degrees_of_freedom(by_channel)
    out["prior"] = (LOG_VARIANCE + 4.0 * by_channel**2) / (4.0 * np.maximum(by_robot, LEAST_SCATTER) ** 2)
    return out, np.array([names.index(row) for row in laws.rows])


@compiled
def update_channels(
    channels: Records,
    laws: Records,
    law_of: NDArray[np.int64],
    mean: PhaseMean,
    comparable: NDArray[np.bool_],
    nominal: Array,
    drift: Array,
    by_load: Array,
    threshold: float,
    start: float,
) -> None:
    """Test the mean of a phase, and learn from it.

    Args:
        channels: `CHANNEL` (n,), updated.
        laws: `LAW`, updated.
        law_of: (n,) index in `laws`.
        mean: of the phase.
        comparable: (n,) channels to be tested against their level; the others are tested against zero alone.
        nominal: (n,) standard deviation from phase to phase, as is usual.
        drift: (n,) variance by which the level moves from phase to phase, as a share of that of the noise.
        by_load: (n,) by which it is off on nominal robots, as a share of the load.
        threshold: standard deviations.
        start: of the phase [s].
    """
    for i in range(channels.shape[0]):
        channel, law, value, usual = channels[i], laws[law_of[i]], mean.values[i], nominal[i] ** 2
        if np.isnan(value):
            continue
        channel.last_phase = start
        if mean.variance[i] > 0.0:
            _test_against_zero(channel, value, mean.variance[i] + _noise(channel, law) * usual, threshold, start)
        if not comparable[i]:
            continue
        if channel.level_phases == 0.0:
            channel.level, channel.level_load, channel.level_phases = value, mean.load[i], 1.0
            channel.level_share = 1.0 + 1.0 / _MEMORY**2 + drift[i]
        else:
            change = mean.load[i] - channel.level_load
            load = (by_load[i] * change) ** 2 / usual
            doubtful = _test_against_level(channel, law, value, usual, load, threshold, start)
            _learn_level(channel, law, doubtful, change, load, drift[i])


@compiled
def _noise(channel: Record, law: Record) -> float:
    """Variance from phase to phase, in nominal ones."""
    of_law = np.exp(law.logs / (law.prior + law.deviations))
    share = (law.alike * of_law + channel.excess) / (law.alike + channel.noise_phases)
    return float(max(share, _MIN_NOISE**2))


@compiled
def as_normal(t: float, freedom: float) -> float:
    """The normal deviate that is as unlikely as one of Student's with this freedom (D. L. Wallace, 1959)."""
    size = np.sqrt(freedom * np.log1p(t * t / freedom))
    return float(np.sign(t) * size * (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0))


@compiled
def _test_against_zero(channel: Record, value: float, variance: float, threshold: float, start: float) -> None:
    """Variance: over nominal robots, and of the noise."""
    sigma = value / np.sqrt(variance)
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
    channel: Record, law: Record, value: float, usual: float, load: float, threshold: float, start: float
) -> bool:
    """Compare with the level, and learn the noise; whether the value is too doubtful to be learnt as a level.

    Args:
        channel, law: updated.
        value: of the phase.
        usual: nominal variance.
        load: variance by another load than that of the level, in nominal variances.
        threshold: standard deviations.
        start: of the phase [s].
    """
    channel.error = value - channel.level
    noise = _noise(channel, law) * (1.0 + channel.level_share)
    square = channel.error**2 / usual
    sigma = as_normal(np.sign(channel.error) * np.sqrt(square / (noise + load)), law.alike + channel.noise_phases)
    # Under another load, little is learnt of the noise; no single value says more than that the threshold is reached.
    square = min(square, threshold**2 * (noise + load)) * noise / (noise + load) / (1.0 + channel.level_share)
    earlier, doubtful = channel.pending, False
    if channel.level_phases >= _MIN_PHASES:
        last = channel.error_sigma
        _extend_run(channel, sigma, start)
        channel.error_sigma, doubtful = sigma, abs(sigma) > _DOUBTFUL
        channel.pending = square if doubtful else 0.0
        if doubtful and sigma * last > 0.0:
            earlier = 0.0  # it was no noise
    if earlier > 0.0:
        _learn_noise(channel, law, earlier)
    if not doubtful:
        _learn_noise(channel, law, square)
    return doubtful


@compiled
def _extend_run(channel: Record, sigma: float, start: float) -> None:
    """Deviations in a row with the same sign and of a similar size: their mean, without the largest.

    The largest alone may be a stumble. The mean of n deviations is less noisy than one by their square root, except for
    the error of the level.
    """
    last = channel.error_sigma
    low, high = min(abs(sigma), abs(last)), max(abs(sigma), abs(last))
    if not (sigma * last > 0.0 and low > max(1.0, _ALIKE * high)):
        channel.run = channel.change_sigma = 0.0
        if abs(sigma) > 1.0:
            channel.change_onset = start
        return
    if channel.run == 0.0 or channel.run >= _LONGEST_RUN:
        channel.run, channel.run_sum, channel.run_most = 1.0, abs(last), abs(last)
    channel.run += 1.0
    channel.run_sum += abs(sigma)
    channel.run_most = max(channel.run_most, abs(sigma))
    gain = np.sqrt((1.0 + channel.level_share) / (1.0 / channel.run + channel.level_share))
    channel.change_sigma = np.sign(sigma) * gain * (channel.run_sum - channel.run_most) / (channel.run - 1.0)


@compiled
def _learn_noise(channel: Record, law: Record, square: float) -> None:
    """A squared deviation, in nominal variances."""
    channel.excess += square
    channel.noise_phases += 1.0
    if channel.noise_phases > _MEMORY:
        channel.excess *= _MEMORY / channel.noise_phases
        channel.noise_phases = _MEMORY
    law.logs += np.log(max(square, 0.1 * _MIN_NOISE**2)) - _LOG_MEAN
    law.deviations += 1.0
    if law.deviations > _LAW_MEMORY:
        law.logs *= _LAW_MEMORY / law.deviations
        law.deviations = _LAW_MEMORY


@compiled
def _learn_level(channel: Record, law: Record, doubtful: bool, load_change: float, load: float, drift: float) -> None:
    """Kalman update of the level; a doubtful value only adds the drift."""
    if doubtful:
        channel.level_share += drift
        return
    share = 1.0 + load / _noise(channel, law)
    gain = channel.level_share / (channel.level_share + share)
    channel.level += gain * channel.error
    channel.level_load += gain * load_change
    channel.level_share = gain * share + 1.0 / _MEMORY**2 + drift
    channel.level_phases += 1.0
