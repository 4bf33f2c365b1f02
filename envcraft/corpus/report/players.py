"""How hard the environments are: what came out of the episodes that were recorded of each player."""

from __future__ import annotations

import msgspec
import numpy as np

from envcraft.corpus.report.data import Z95
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
        steps, total = (
            tuple(float(value) for value in np.quantile(values, (0.1, 0.5, 0.9)))
            for values in ([outcome.steps for outcome in outcomes], [outcome.total for outcome in outcomes])
        )
        found.append(PlayerRow(name, len(outcomes), steps, total, Proportion(sum(told), len(told), Z95)))
    return sorted(found, key=lambda row: row.steps[1])
