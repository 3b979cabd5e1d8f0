# SPDX-License-Identifier: BSD-3-Clause
"""One record for a parameter: it serves the configuration file, the ROS descriptor and the fitting bounds."""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import ConfigError

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]

_TYPE_NAMES = {
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "floats": "a list of numbers",
    "strs": "a list of texts",
}
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")


@dataclass(frozen=True)
class Parameter:
    """A named value with its nominal, bounds, unit and meaning.

    Attributes:
        name: dotted key, such as `support.contact_on`.
        kind: bool, int, float, str, floats or strs.
        nominal: value when nothing else is said.
        unit: SI unit, or "" for text and switches, "1" for ratios.
        description: one line for people.
        low, high: inclusive bounds; also of each element of `floats`.
        choices: the allowed texts; None: any.
        length: the required number of elements of a list; None: any.
        runtime: may change while a node runs.
    """

    name: str
    kind: str
    nominal: Value
    unit: str
    description: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] | None = None
    length: int | None = None
    runtime: bool = False

    def check(self, value: Any, source: str) -> Value:
        """The value in its canonical type (whole numbers become floats where a float is meant, lists tuples).

        Raises:
            ConfigError: wrong type or out of range; says the source, key, value and what is allowed.
        """
        checked = self._typed(value)
        if checked is None:
            like = f"; wanted [{value}]?" if self.kind == "strs" and isinstance(value, str) else ""
            raise ConfigError(
                f"{source}: {self.name}: {value!r} is not {_TYPE_NAMES[self.kind]} ({self.allowed()}{like})"
            )
        elements = checked if isinstance(checked, tuple) else (checked,)
        if self.length is not None and len(elements) != self.length:
            raise ConfigError(
                f"{source}: {self.name}: {len(elements)} elements, {self.length} wanted ({self.allowed()})"
            )
        for element in elements:
            if isinstance(element, str):
                if self.choices is not None and element not in self.choices:
                    hint = difflib.get_close_matches(element, self.choices, 1)
                    meant = f"; did you mean {hint[0]!r}?" if hint else ""
                    raise ConfigError(f"{source}: {self.name}: {element!r} is not allowed ({self.allowed()}{meant})")
            elif not isinstance(element, bool) and not self.low <= element <= self.high:
                raise ConfigError(f"{source}: {self.name}: {element} is out of range ({self.allowed()})")
        return checked

    def _typed(self, value: Any) -> Value | None:
        if self.kind == "bool":
            return value if isinstance(value, bool) else None
        if self.kind == "int":
            return value if isinstance(value, int) and not isinstance(value, bool) else None
        if self.kind == "float":
            return _number(value)
        if self.kind == "str":
            return value if isinstance(value, str) else None
        if isinstance(value, (str, bytes, dict)) or not hasattr(value, "__iter__"):
            return None
        # ROS parameter files have no empty lists: [""] is the custom for one.
        if list(value) == [""]:
            return ()
        if self.kind == "floats":
            numbers = [_number(element) for element in value]
            return None if None in numbers else tuple(number for number in numbers if number is not None)
        texts = list(value)
        if not all(isinstance(text, str) for text in texts):
            return None
        return tuple(texts)

    def allowed(self) -> str:
        """What is allowed, in words."""
        if self.choices is not None:
            return "allowed: " + ", ".join(repr(choice) for choice in self.choices)
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        if self.kind in ("int", "float", "floats") and (math.isfinite(self.low) or math.isfinite(self.high)):
            return f"allowed: {self.low:g} to {self.high:g}{unit}"
        return f"wanted: {_TYPE_NAMES[self.kind]}{f', in{unit}' if unit else ''}"


def par(
    nominal: Value,
    unit: str,
    description: str,
    low: float = float("-inf"),
    high: float = float("inf"),
    *,
    choices: tuple[str, ...] | None = None,
    length: int | None = None,
    runtime: bool = False,
    kind: str | None = None,
) -> Any:
    """A dataclass field that declares a parameter; its dotted name comes from where it stands."""
    if kind is None:
        kind = {bool: "bool", int: "int", float: "float", str: "str"}.get(type(nominal)) or (
            "strs" if isinstance(nominal, tuple) and nominal and isinstance(nominal[0], str) else "floats"
        )
    parameter = Parameter("", kind, nominal, unit, description, low, high, choices, length, runtime)
    return field(default=nominal, metadata={"parameter": parameter})


def _number(value: Any) -> float | None:
    """The value as a finite float; None where it is no number (a bool is none)."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str) and _EXPONENT.fullmatch(value):  # YAML 1.1 takes 1e-6 for a text, ROS for a number
        value = float(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:  # an integer of more than 308 digits
        return None
