"""The section of the report on how hard the environments are: the outcomes of each player's recorded episodes."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from envcraft.corpus.store import Store, demonstrations
from envcraft.judging.statistics import Proportion


class PlayerRow(msgspec.Struct, frozen=True):
    """The complete episodes of one player in all environments.

    Attributes:
        name: the player.
        episodes: how many episodes.
        steps: the 10%, 50% and 90% quantiles of their steps.
        total: the same quantiles of their returns.
        rate: the share of won episodes, of those that report success.
    """

    name: str
    episodes: int
    steps: tuple[float, float, float]
    total: tuple[float, float, float]
    rate: Proportion


def player_rows(store: Store) -> list[PlayerRow]:
    """The players with complete episodes, the one with the shortest episodes first."""
    by_player: dict[str, list[demonstrations.EpisodeOutcome]] = {}
    for player, outcome in demonstrations.outcomes(store):
        by_player.setdefault(player, []).append(outcome)
    rows = []
    for name, outcomes in by_player.items():
        won = [bool(outcome.success) for outcome in outcomes if outcome.success is not None]
        steps = _quantiles([outcome.steps for outcome in outcomes])
        total = _quantiles([outcome.total for outcome in outcomes])
        rows.append(PlayerRow(name, len(outcomes), steps, total, Proportion(sum(won), len(won))))
    return sorted(rows, key=lambda row: row.steps[1])


def _quantiles(values: Sequence[float]) -> tuple[float, float, float]:
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9)).tolist()
    return low, middle, high
