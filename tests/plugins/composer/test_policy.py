"""The player of the family `composer`, where a plan must wait or look ahead."""

from __future__ import annotations

from typing import Any

import pytest
from envcraft_composer import policy

from tests.plugins.composer.composed import game


def played(env: Any, limit: int) -> dict[str, Any]:
    """The info after the player's last step."""
    player = policy.Composed()
    for _ in range(limit):
        *_, terminated, truncated, info = env.step(player.act(env))
        if terminated or truncated:
            break
    return dict(info)


@pytest.mark.parametrize("seed", range(3))
def test_states_at_different_times_of_a_cycle_are_different_states(seed: int) -> None:
    env = game("halls turtle switches magnet calm hurry")
    env.reset(seed=seed)
    assert played(env, 600)["is_success"]


def test_lost_crates_do_not_cost_a_whole_search_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policy, "_CRATES", 2_000)
    monkeypatch.setattr(policy, "_CRATES_ALLOWANCE", 5_000)
    env = game("crosses walker crates plain calm hurry")
    env.marks = [(-1, column) for column, _ in enumerate(env.marks)]
    player = policy.Composed()
    plans = 0
    while plans < 10:
        plans += not player._plan
        env.step(player.act(env))
    assert player.model.spent <= 5_000 + 10 * policy._LEAST


def test_a_crate_in_a_corner_is_far_from_each_mark() -> None:
    env = game("field walker crates plain calm hurry")
    env.walls = {(y, x) for y in range(-1, 12) for x in range(-1, 12) if not (0 <= y < 6 and 0 <= x < 6)}
    env.marks = [(2, 0), (4, 3)]
    player = policy.Composed()
    env.crates = [(2, 2), (4, 2)]
    near = player._to_marks(env)
    env.crates = [(0, 0), (4, 2)]
    assert player._to_marks(env) > near + 100
