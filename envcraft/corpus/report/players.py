"""The section of the report on how hard the environments are: the outcomes of each player's recorded episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from envcraft.corpus.store import Environment, Store, demonstrations
from envcraft.judging.statistics import Proportion
from envcraft.text import one_line

#: Episodes of a player that the page of an environment shows.
_SHOWN = 200


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


def played(store: Store, environment: Environment) -> list[dict[str, Any]]:
    """The recorded episodes of one environment, by player: their steps, returns and successes, the newest first."""
    by_player: dict[str, dict[str, Any]] = {}
    for player, outcome in demonstrations.outcomes_of(store, environment.source, environment.env_class):
        row = by_player.setdefault(player, {"player": one_line(player), "steps": [], "totals": [], "won": []})
        if len(row["steps"]) < _SHOWN:
            for column, value in zip(("steps", "totals", "won"), outcome, strict=True):
                row[column].append(value)
    return list(by_player.values())


def _quantiles(values: Sequence[float]) -> tuple[float, float, float]:
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9)).tolist()
    return low, middle, high
