"""The stages of generation whose outcomes a corpus has."""

from __future__ import annotations

from collections.abc import Iterable

from envcraft.model.stage_order import ordered
from envcraft.registry import offered


def in_running_order(stages: Iterable[str]) -> list[str]:
    """Sort names of stages in the order in which they run; those that no plugin provides any more come last.

    Raises:
        UsageError: If the stages of plugins have no order.
    """
    names = [stage.name for stage in ordered(offered("envcraft_stages"))]
    return sorted(stages, key=lambda name: (names.index(name) if name in names else len(names), name))
