# SPDX-License-Identifier: BSD-3-Clause
"""MuJoCo's C functions by their addresses, for compiled code."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from ..core.base.types import Integers

FUNCTIONS = ("mj_step", "mj_rnePostConstraint", "mj_subtreeVel", "mj_objectVelocity", "mj_objectAcceleration")


@cache
def _library() -> ctypes.CDLL:
    """The library that the Python package has loaded."""
    names = ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll")
    found = (path for name in names for path in Path(mujoco.__file__).parent.glob(name))
    return ctypes.CDLL(str(next(found)))


@cache
def addresses() -> Integers:
    """Addresses of FUNCTIONS, in their order."""
    library = _library()
    return np.array([ctypes.cast(getattr(library, name), ctypes.c_void_p).value for name in FUNCTIONS], dtype=np.int64)


@intrinsic
def call(typing: Any, address: Any, arguments: Any) -> Any:
    """Call the C function at an address with a tuple of integers and addresses; what it returns is dropped."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        word = ir.IntType(64)
        function = builder.inttoptr(values[0], ir.FunctionType(ir.VoidType(), [word] * len(arguments)).as_pointer())
        builder.call(function, [builder.extract_value(values[1], i) for i in range(len(arguments))])
        return context.get_dummy_value()

    return types.none(types.int64, types.UniTuple(types.int64, len(arguments))), generate
