# SPDX-License-Identifier: BSD-3-Clause
"""Predictions h seconds ahead: blended, and judged when the measurement arrives, all on the same samples.

A model that is wrong in a stride is wrong in the next one in the same way. So the blend has one more predictor while
the robot repeats itself: the model less its error of one stride before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.compiled import Held, compiled, hold
from ..base.types import Array
from .baselines import BASELINES, best_baseline
from .blend import KNOWN, OWN, begin_with, blend, forget, learn, no_experience, weigh
from .sigma import UNKNOWN, Experiences, Spread, carry, covariance_ahead
from .statistics import LEVELS, QUANTILES

Ints = NDArray[np.int64]
# What the model goes through, each with an experience of its own: nothing that moves, the stride before, planned steps.
HELD, REPEATED, STEPPING = range(3)
# published: the blend of the model and its baselines. clairvoyant: a rigid robot that knows what its motors will do.
# corrected: the model less its error one stride before, where a stride is repeated.
PREDICTORS = ("published", "model", "corrected", *BASELINES, "clairvoyant")
WITH_REFERENCE = ("planned", "deflected", "clairvoyant")
_CAPACITY = 4096  # pending predictions a horizon: 2 s at 2 kHz
_REMEMBERED = 2048  # errors of the model a horizon: 10 s and more
_SPACING_NS, _NEAR_NS = 5_000_000, 50_000_000  # between them; within which two of them say what was between
_BROKE_NS = 150_000_000  # without a sample on the ground, after which what was predicted is not judged
_EVERY_NS = 20_000_000  # between new weights of the blend


class Pending(NamedTuple):
    """Predictions that wait for the measurement, a ring of slots for each of n horizons."""

    ahead_ns: Ints  # (n,) the horizons [ns]
    targets: Ints  # (n, slots) stamps that are predicted [ns]
    poses: Array  # (n, slots, 4, 4) of the sole that predicted, in odom
    predicted: Array  # (n, slots, 9, 3) by PREDICTORS, in odom [m]
    sigma: Array  # (n, slots, 3) what the published ones were expected to be off by, in the sole [m]
    kinds: Ints  # (n, slots) index of the experience that they belong to
    first: Ints  # (n,) oldest slot
    used: Ints  # (n,) slots in use


class Past(NamedTuple):
    """Errors of the model through repeated strides, a ring of slots for each of n horizons."""

    stamps: Ints  # (n, slots) at which it predicted [ns]
    errors: Array  # (n, slots, 3) in the axes of the sole that predicted [m]; NaN where it repeated none
    taken: Ints  # (n,) so far


class Errors(NamedTuple):
    """Squared errors so far, and what the next ones are interpolated from."""

    sums: Array  # (n, 9, 3) [m^2]
    judged: Ints  # (n, 3) how many
    expected: Ints  # (11, n, 3) of the published ones with a sigma: within the interval of each of LEVELS, and all
    simpler: Ints  # (2, n, 3) samples at which a baseline had been better than the model, and all of them
    needed: NDArray[np.bool_]  # (9,) predictors without which nothing counts
    last: Array  # (2, 3) measured and reference COM in odom at the last sample [m]


class HorizonJudge:
    """Blends the predictors by their errors so far, and collects squared errors of each, at each horizon and axis.

    Sums are over the samples where all predictors have a value, so that their errors are comparable. Axes are those of
    the sole that predicted.
    """

    def __init__(self, horizons: tuple[float, ...], rigid: bool = True, blended: bool = True) -> None:
        """Horizons in seconds.

        Without `rigid` there is no reference, and what needs one is left out (NaN); without `blended` the model is
        published as it is.
        """
        self.horizons = horizons
        self._blended = blended
        n, predictors = len(horizons), len(PREDICTORS)
        self._pending = Pending(
            np.array([round(h * 1e9) for h in horizons], dtype=np.int64),
            np.zeros((n, _CAPACITY), dtype=np.int64),
            np.zeros((n, _CAPACITY, 4, 4)),
            np.zeros((n, _CAPACITY, predictors, 3)),
            np.zeros((n, _CAPACITY, 3)),
            np.zeros((n, _CAPACITY), dtype=np.int64),
            np.zeros(n, dtype=np.int64),
            np.zeros(n, dtype=np.int64),
        )
        self._errors = Errors(
            np.zeros((n, predictors, 3)),
            np.zeros((n, 3), dtype=np.int64),
            np.zeros((1 + len(LEVELS), n, 3), dtype=np.int64),
            np.zeros((2, n, 3), dtype=np.int64),
            np.array([name != "corrected" and (rigid or name not in WITH_REFERENCE) for name in PREDICTORS]),
            np.full((2, 3), np.nan),
        )
        self._past = Past(
            np.zeros((n, _REMEMBERED), dtype=np.int64), np.zeros((n, _REMEMBERED, 3)), np.zeros(n, dtype=np.int64)
        )
        k = OWN + len(BASELINES)
        # A model without a reference makes nothing of a plan: what follows the plan is expected to be better.
        best = 0 if rigid else OWN + BASELINES.index("deflected")
        # Through a stride that is repeated, or through planned steps, the model is another one than without, and so are
        # simpler predictions: each kind has its own errors.
        held, repeated, stepping = (no_experience(n, k, best) for _ in range(3))
        self.experiences: Experiences = (held, repeated, stepping)
        self._known = hold((self._pending, self._errors, self._past, *self.experiences))
        self._kind, self._repeated = 0, False
        self._simpler = False  # whether a baseline has been better than the model, through the last kind
        self._last_ns = self._weighed_ns = 0

    def restart(self) -> None:
        """Drop the pending predictions, and the strides before: the stream broke off. What the blend knows is kept."""
        self._pending.used[:] = self._past.taken[:] = 0
        self._errors.last[:] = np.nan
        self._weighed_ns = 0

    def update(
        self,
        stamp_ns: int,
        T_odom_sole: Array,
        measured: Array,
        reference: Array,
        ahead: Array,
        kind: int = HELD,
        lag_ns: int = 0,
        spread: Spread = UNKNOWN,
        ready: bool = True,
    ) -> Array:
        """Judge what is due at this sample and take its predictions in.

        Args:
            stamp_ns: of the sample.
            T_odom_sole: (4, 4) pose of the support sole.
            measured, reference: (3,) COM now [m], in the sole frame; reference NaN if there is none.
            ahead: (6, n, 3) predictions [m] in the sole frame, of the model and by BASELINES; NaN where none.
            kind: HELD, REPEATED or STEPPING: what the model went through.
            lag_ns: REPEATED: how long ago it was where it is now.
            spread: how sure the estimate is, in the axes of the sole.
            ready: whether anything is published; without, the simpler predictions are judged all the same.

        Returns:
            What is published, (n, 5, 3) in the axes of the sole: COM [m], `covariance` in three rows, `model_share`.
        """
        if stamp_ns - self._last_ns > _BROKE_NS:  # nobody knows where the COM was meanwhile
            self._pending.used[:] = 0
        reweigh = self._blended and stamp_ns - self._weighed_ns >= _EVERY_NS
        if kind == REPEATED and not self._repeated:
            self._repeated = True
            begin_with(self.experiences[kind], self.experiences[self._kind])
        self._kind = kind
        made = np.empty((ahead.shape[1], 5, 3))
        self._simpler = _update(
            self._known, stamp_ns, self._last_ns, T_odom_sole, measured, reference, ahead, made,
            (self._blended, ready, reweigh, self._kind, lag_ns), spread,
        )  # fmt: skip
        if reweigh:
            self._weighed_ns = stamp_ns
        self._last_ns = stamp_ns
        return made

    def count_from_now(self) -> None:
        """Forget the errors that were counted; what the blend knows stays."""
        for each in (self._errors.sums, self._errors.judged, self._errors.expected, self._errors.simpler):
            each[:] = 0

    def covariance(self, h: int) -> Array:
        """(3, 3) [m^2] of the published prediction at the horizon of an index, by errors alone; NaN: too few yet."""
        found = np.full((3, 3), np.nan)
        covariance_ahead(self.experiences, h, found)
        return found

    def model_share(self, h: int) -> Array:
        """(3,) [1] of the model, corrected or not, in the published prediction at the horizon of an index, by axis."""
        return np.asarray(self.experiences[self._kind].weights[h, :, :OWN].sum(axis=1))

    @property
    def simpler_is_better(self) -> bool:
        """Whether on some axis, at some horizon, a baseline has lately been better than the model."""
        return self._simpler

    def simpler(self) -> list[tuple[str, int, str]]:
        """Horizon (as text), axis and the best baseline, wherever it has lately been better than the model."""
        experience, found = self.experiences[self._kind], []
        for h, axis in np.argwhere(experience.worse).tolist():
            moments, times = (np.diag(each[h, axis])[OWN:] for each in (experience.moments, experience.times))
            with np.errstate(invalid="ignore", divide="ignore"):
                errors = np.where(times > KNOWN, moments / times, np.inf)
            found.append((f"{self.horizons[h]:g}", axis, BASELINES[errors.argmin()]))
        return found

    def simpler_share(self) -> dict[str, Array]:
        """Share (3,) of the samples at which a baseline had lately been better than the model, a horizon."""
        return self._shares(self._errors.simpler)[0]

    def rmse(self) -> dict[str, dict[str, Array]]:
        """RMSE (3,) [m] by horizon (as text, `0.1`) and predictor; NaN where nothing was judged.

        The corrected model has none of its own: it is not known all the time.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            means = np.sqrt(self._errors.sums / self._errors.judged[:, None, :])
        names = [(k, name) for k, name in enumerate(PREDICTORS) if name != "corrected"]
        return {f"{h:g}": {name: means[i, k] for k, name in names} for i, h in enumerate(self.horizons)}

    def skill(self) -> dict[str, Array]:
        """1 - RMSE of what is published / RMSE of the best baseline, (3,) a horizon; NaN where nothing was judged."""
        skills = {}
        for h, errors in self.rmse().items():
            best = [best_baseline({name: each[axis] for name, each in errors.items()})[0] for axis in range(3)]
            with np.errstate(invalid="ignore", divide="ignore"):
                skills[h] = 1.0 - errors["published"] / best
        return skills

    def within(self) -> dict[str, Array]:
        """Share (3,) of the published predictions that were within their 90 % interval, a horizon; NaN: none known."""
        return self._shares(self._errors.expected)[LEVELS.index(0.9)]

    def reliability(self) -> dict[str, dict[str, float]]:
        """By horizon and level of an interval, the share of errors within it, all axes together; NaN: none known."""
        shares = self._shares(self._errors.expected.sum(axis=2))
        levels = dict(zip(map(str, LEVELS), shares, strict=True))
        return {f"{h:g}": {k: float(by[f"{h:g}"]) for k, by in levels.items()} for h in self.horizons}

    def _shares(self, counts: Ints) -> list[dict[str, Array]]:
        """Of counts (k, n, ...), the last of which is of all, shares by horizon for each of the others."""
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = counts[:-1] / counts[-1]
        return [{f"{h:g}": each[i] for i, h in enumerate(self.horizons)} for each in shares]

    @property
    def judged(self) -> dict[str, Array]:
        """How many predictions were judged, (3,) a horizon."""
        return {f"{h:g}": self._errors.judged[i].copy() for i, h in enumerate(self.horizons)}


@compiled
def _to_odom(T: Array, p: Array, out: Array) -> None:
    for i in range(3):
        out[i] = T[i, 0] * p[0] + T[i, 1] * p[1] + T[i, 2] * p[2] + T[i, 3]


@compiled
def _update(
    held: Held, stamp_ns: int, last_ns: int, pose: Array, measured: Array, reference: Array, ahead: Array, made: Array,
    options: tuple[bool, bool, bool, int, int], spread: Spread,
) -> bool:  # fmt: skip
    """`HorizonJudge.update`, into `made`; options: whether to blend, to publish, and by new weights, kind and lag.

    Returns whether a baseline has been better than the model.
    """
    (blended, ready, reweigh, kind, lag_ns), known = options, held.value
    pending, errors, past, experiences = known[0], known[1], known[2], known[3:]
    experience = experiences[kind]
    published = made[:, 0]
    published[:] = ahead[0]
    every = np.empty((1 + ahead.shape[0], ahead.shape[1], 3))
    every[0], every[1], every[OWN:] = ahead[0], np.nan, ahead[1:]
    now = np.empty((2, 3))
    _to_odom(pose, measured, now[0])
    _to_odom(pose, reference, now[1])
    _judge_due(pending, errors, past, experiences, stamp_ns, last_ns, now)
    if kind == REPEATED:
        for h in range(ahead.shape[1]):
            _error_at(past, h, stamp_ns - lag_ns, every[1, h])
            for i in range(3):
                every[1, h, i] = ahead[0, h, i] - every[1, h, i]
    if reweigh:
        for each in experiences:
            weigh(each)
    if blended and ready:
        blend(experience, every, published)
    for h in range(made.shape[0]):
        carry(spread, pending.ahead_ns[h] * 1e-9, made[h, 1:4])
        covariance_ahead(experiences, h, made[h, 1:4])
        for i in range(3):
            weights = experience.weights[h, i]
            made[h, 4, i] = weights[0] + weights[1]  # of its OWN
            errors.simpler[0, h, i] += ready and experience.worse[h, i]
            errors.simpler[1, h, i] += ready
    _add(pending, made, kind, stamp_ns, pose, every)
    errors.last[:] = now
    return experience.worse.any()


@compiled
def _judge_due(
    pending: Pending, errors: Errors, past: Past, experiences: Experiences, stamp_ns: int, last_ns: int,
    now: Array,
) -> None:  # fmt: skip
    """Judge the predictions of stamps up to this one by measured and reference COM now (2, 3), in odom [m]."""
    first, used, capacity = pending.first, pending.used, pending.targets.shape[1]
    for h in range(pending.targets.shape[0]):
        dt = (stamp_ns - last_ns) * 1e-9
        while used[h] > 0 and pending.targets[h, first[h]] <= stamp_ns:
            slot = first[h]
            first[h] = (slot + 1) % capacity
            used[h] -= 1
            w = (pending.targets[h, slot] - last_ns) / (stamp_ns - last_ns)
            true = (1.0 - w) * errors.last + w * now
            values = pending.predicted[h, slot]
            values[-1] = true[1]  # the rigid robot is at its reference
            off = _errors_of(pending.poses[h, slot], values, true[0])
            _add_errors(errors, h, off, pending.sigma[h, slot])
            kind = pending.kinds[h, slot]
            _remember_error(past, h, pending.targets[h, slot] - pending.ahead_ns[h], off[1], kind == REPEATED)
            learn(experiences[kind], h, off[1:-1], off[0], dt)
            for i, other in enumerate(experiences):  # what is published has one covariance, of the last seconds
                if i != kind:
                    forget(other, h, dt)
            dt = 0.0  # of several that are due, the first one stands for the time


@compiled
def _remember_error(past: Past, h: int, stamp_ns: int, off: Array, repeated: bool) -> None:
    """Keep the error (3,) [m] of what the model predicted at a stamp."""
    count, slots = past.taken[h], past.stamps.shape[1]
    if count and stamp_ns - past.stamps[h, (count - 1) % slots] < _SPACING_NS:
        return
    past.stamps[h, count % slots] = stamp_ns
    for i in range(3):
        past.errors[h, count % slots, i] = off[i] if repeated else np.nan
    past.taken[h] = count + 1


@compiled
def _error_at(past: Past, h: int, stamp_ns: int, out: Array) -> None:
    """Fill in the error (3,) [m] of what the model predicted at a stamp; NaN where it is not known."""
    out[:] = np.nan
    count, slots = past.taken[h], past.stamps.shape[1]
    low, high = max(count - slots, 0), count
    while low < high:  # the first one that is not before the stamp
        middle = (low + high) // 2
        if past.stamps[h, middle % slots] < stamp_ns:
            low = middle + 1
        else:
            high = middle
    if low == count or low == max(count - slots, 0):
        return
    before, after = (low - 1) % slots, low % slots
    gap = past.stamps[h, after] - past.stamps[h, before]
    if gap > _NEAR_NS:
        return
    w = (stamp_ns - past.stamps[h, before]) / gap
    for i in range(3):
        out[i] = (1.0 - w) * past.errors[h, before, i] + w * past.errors[h, after, i]


@compiled
def _errors_of(pose: Array, values: Array, measured: Array) -> Array:
    """Errors (9, 3) of all predictors in odom, along the axes of the sole that predicted."""
    off = np.zeros(values.shape)
    for k in range(values.shape[0]):
        for i in range(3):
            for j in range(3):
                off[k, i] += pose[j, i] * (values[k, j] - measured[j])
    return off


@compiled
def _add_errors(errors: Errors, h: int, off: Array, sigma: Array) -> None:
    """Square the errors (9, 3) of all predictors."""
    for i in range(3):
        complete = True
        for k in range(off.shape[0]):
            complete &= not (errors.needed[k] and np.isnan(off[k, i]))
        if complete:
            errors.judged[h, i] += 1
            for k in range(off.shape[0]):
                errors.sums[h, k, i] += off[k, i] ** 2
        if np.isfinite(sigma[i]) and np.isfinite(off[0, i]):
            for k in range(QUANTILES.shape[0]):
                errors.expected[k, h, i] += abs(off[0, i]) <= QUANTILES[k] * sigma[i]
            errors.expected[-1, h, i] += 1


@compiled
def _add(pending: Pending, made: Array, kind: int, stamp_ns: int, pose: Array, ahead: Array) -> None:
    """Take in what is published (n, 5, 3), and all predictions (7, n, 3); dropped if all slots are in use."""
    capacity = pending.targets.shape[1]
    for h in range(pending.targets.shape[0]):
        if pending.used[h] < capacity:
            slot = (pending.first[h] + pending.used[h]) % capacity
            pending.used[h] += 1
            pending.targets[h, slot] = stamp_ns + pending.ahead_ns[h]
            pending.poses[h, slot] = pose
            pending.kinds[h, slot] = kind
            for i in range(3):
                pending.sigma[h, slot, i] = np.sqrt(made[h, 1 + i, i])
            _to_odom(pose, made[h, 0], pending.predicted[h, slot, 0])
            for k in range(ahead.shape[0]):
                _to_odom(pose, ahead[k, h], pending.predicted[h, slot, 1 + k])
