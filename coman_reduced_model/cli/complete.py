# SPDX-License-Identifier: BSD-3-Clause
"""Values that the shell completes: parameters, gaits, kinds of worlds. Nothing is imported before it is asked for."""

from __future__ import annotations


def parameters(incomplete: str) -> list[tuple[str, str]]:
    """`KEY=` of every parameter that begins so, each with its meaning."""
    from ..core.config.schema import parameter_table

    meanings = {f"{key}=": each.description.partition(";")[0] for key, each in parameter_table().items()}
    return [(key, text) for key, text in meanings.items() if key.startswith(incomplete)]


def gaits(incomplete: str) -> list[str]:
    """Named gaits."""
    from ..core.gait.parameters import GAITS

    return [name for name in GAITS if name.startswith(incomplete)]


def worlds(incomplete: str) -> list[tuple[str, str]]:
    """Kinds of worlds, each with what it is."""
    from ..sim.worlds.kinds import AXES

    found = [(kind.name, kind.sentence) for kinds in AXES.values() for kind in kinds.values()]
    return [(name, text) for name, text in found if name.startswith(incomplete)]
