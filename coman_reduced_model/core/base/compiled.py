# SPDX-License-Identifier: BSD-3-Clause
"""Numba for code that runs at the rate of the sensors, and linear algebra for matrices too small for BLAS."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
from numba import config, njit, types
from numba.experimental import structref
from numpy.typing import NDArray

from .types import Array, Integers

Records = NDArray[np.void]  # a structured array
Record = Any  # one element of it: in compiled code, its fields are attributes
_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile a function: once a machine, beside the source or, where that is read-only, in the user's cache.

    Where neither can be written, once a process. A division by zero gives infinity or NaN as in numpy instead of an
    exception, since no message may stop a node.
    """
    try:
        return njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # no place for a cache
        return njit(error_model="numpy")(function)


def _drop_stale_caches(package: Path = Path(__file__).parents[1]) -> None:
    """Forget what was compiled before the newest source: numba watches the file of a function, not what it calls.

    Also what lies outside of the core: it calls what is in the core and in its own folder.
    """
    newest = _newest(package.rglob("*.py"))
    for index in package.parent.rglob("__pycache__/*.nbi"):
        try:
            if index.stat().st_mtime_ns < max(newest, _newest(index.parents[1].glob("*.py"))):
                index.unlink()
                # numba writes a new index before the code: until then another process would load what was there before.
                for code in index.parent.glob(f"{index.stem}.*.nbc"):
                    code.unlink(missing_ok=True)
        except OSError:  # read-only, or another process was faster
            continue


def _newest(sources: Iterable[Path]) -> int:
    return max(source.stat().st_mtime_ns for source in sources)


_drop_stale_caches()


@structref.register
class _HeldType(types.StructRef):
    """What numba takes `Held` for."""


class Held(structref.StructRefProxy):
    """A tuple of arrays and numbers that compiled functions get again and again: there, `value` is the tuple.

    Handed over as it is, a named tuple of twelve arrays costs a call more than a microsecond; held, it costs half of
    one whatever its length, as much as ten arrays one by one. The arrays remain those of Python.
    """

    _numba_type_ = structref.StructRefProxy._type  # a property in Python, which each call reads twice, is slower


structref.define_proxy(Held, _HeldType, ["value"])


def hold(value: tuple) -> Any:
    """A tuple as `Held`; without numba, whatever has it as its `value`."""
    return SimpleNamespace(value=value) if config.DISABLE_JIT else _hold(value)


@compiled
def _hold(value: tuple) -> Held:
    return Held(value)


# Loops instead of array expressions: they compile several times faster, and run as fast.


@compiled
def mul(A: Array, B: Array) -> Array:
    """The product (n, m) of A (n, k) and B (k, m)."""
    C = np.empty((A.shape[0], B.shape[1]))
    mul_into(C, A, B)
    return C


@compiled
def mul_into(C: Array, A: Array, B: Array) -> None:
    """`mul` into a matrix (n, m) that there is already, and that is neither A nor B."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            C[i, j] = 0.0
        for k in range(A.shape[1]):
            a = A[i, k]
            for j in range(B.shape[1]):
                C[i, j] += a * B[k, j]


@compiled
def apply(A: Array, x: Array) -> Array:
    """The product (n,) of A (n, k) and x (k,)."""
    y = np.zeros(A.shape[0])
    add_product(y, A, x)
    return y


@compiled
def add_product(y: Array, A: Array, x: Array) -> None:
    """Add the product of A (n, k) and x (k,) to y (n,), in place; y may be longer."""
    for k in range(A.shape[1]):  # columns first: sums that do not wait for each other
        for i in range(A.shape[0]):
            y[i] += A[i, k] * x[k]


@compiled
def all_finite(x: Array) -> bool:
    """Whether no entry of x (n,) is infinite or NaN: numpy needs ten times as long for a few numbers."""
    total = 0.0
    for i in range(x.shape[0]):
        total += 0.0 * x[i]
    return total == 0.0


@compiled
def pick(x: Array, axes: Integers) -> Array:
    """The entries `axes` (n,) of x (d,)."""
    y = np.empty(axes.shape[0])
    for i in range(axes.shape[0]):
        y[i] = x[axes[i]]
    return y


@compiled
def inverse(A: Array) -> Array:
    """The inverse of A (n, n) by Gauss and Jordan with row pivots; infinite or NaN where there is none."""
    n = A.shape[0]
    L, B = A.copy(), np.eye(n)
    for c in range(n):
        pivot = c
        for i in range(c + 1, n):
            if abs(L[i, c]) > abs(L[pivot, c]):
                pivot = i
        scale = 1.0 / L[pivot, c]
        for j in range(n):
            L[c, j], L[pivot, j] = L[pivot, j], L[c, j]
            B[c, j], B[pivot, j] = B[pivot, j], B[c, j]
            L[c, j] *= scale
            B[c, j] *= scale
        for i in range(n):
            factor = L[i, c]
            if i != c and factor != 0.0:
                for j in range(n):
                    L[i, j] -= factor * L[c, j]
                    B[i, j] -= factor * B[c, j]
    return B


@compiled
def inverse_positive(A: Array) -> Array:
    """The inverse of a symmetric positive definite A (n, n), in a fifth of the time of `inverse`."""
    n = A.shape[0]
    B, row = A.copy(), np.empty(n)  # swept pivot by pivot, it becomes minus the inverse
    for k in range(n):
        d = 1.0 / B[k, k]
        for j in range(n):
            row[j] = B[k, j]
        row[k] = 0.0
        for i in range(n):
            scaled = row[i] * d
            for j in range(n):
                B[i, j] -= scaled * row[j]
            B[i, k] = B[k, i] = scaled
        B[k, k] = -d
    for i in range(n):
        for j in range(n):
            B[i, j] = -B[i, j]
    return B
