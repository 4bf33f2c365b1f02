"""How hard the environments are: what came out of the episodes that were recorded of each player."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from envcraft.corpus.store import Store
from envcraft.demonstrations import keeping
from envcraft.stats import Proportion


class PlayerRow(msgspec.Struct, frozen=True):
    """One player's whole episodes over all environments: quantiles at 10, 50 and 90% of their steps and returns.

    `rate` is of those that tell whether they were won.
    """

    name: str
    episodes: int
    steps: tuple[float, float, float]
    total: tuple[float, float, float]
    rate: Proportion


def player_rows(store: Store) -> list[PlayerRow]:
    """The one whose episodes are shortest first; those without a whole episode are left out."""
    found = []
    for name, outcomes in keeping.outcomes(store).items():
        told = [bool(outcome.success) for outcome in outcomes if outcome.success is not None]
        steps = _quantiles([outcome.steps for outcome in outcomes])
        total = _quantiles([outcome.total for outcome in outcomes])
        found.append(PlayerRow(name, len(outcomes), steps, total, Proportion(sum(told), len(told))))
    return sorted(found, key=lambda row: row.steps[1])


def _quantiles(values: Sequence[float]) -> tuple[float, float, float]:
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9)).tolist()
    return low, middle, high
