"""The planner of privileged players: copies, searches, and policies in one text."""

from __future__ import annotations

import types
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from envcraft.demonstrations.planning import Action, Macro, Model, Planner, beam, best_first
from envcraft.demonstrations.player import policy_with_planning

MOVES: tuple[Macro, ...] = tuple(((move, 0, 0),) for move in range(5))
STEPS = {0: (0, 0), 1: (-1, 0), 2: (1, 0), 3: (0, -1), 4: (0, 1)}
ACROSS = ("S..#....", ".#.#.##.", ".#...#..", ".####.#.", "......#G")


class Walk(gym.Env[Any, Any]):
    """A maze with a pit that ends the episode, and a gust of wind that pushes at random."""

    def __init__(self, rows: tuple[str, ...] = ACROSS, gusts: float = 0.0) -> None:
        self.rows, self.gusts = rows, gusts
        self.action_space = gym.spaces.MultiDiscrete([5, 2, 2])
        self.drawn = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.at = (0, 0)
        self.seen = [[0] * len(self.rows[0]) for _ in self.rows]
        return self.render(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        move = int(action[0])
        if self.gusts and self.np_random.random() < self.gusts:
            move = int(self.np_random.integers(1, 5))
        y, x = self.at[0] + STEPS[move][0], self.at[1] + STEPS[move][1]
        if 0 <= y < len(self.rows) and 0 <= x < len(self.rows[0]) and self.rows[y][x] != "#":
            self.at = (y, x)
        self.seen[self.at[0]][self.at[1]] += 1
        mark = self.rows[self.at[0]][self.at[1]]
        return self.render(), -1.0, mark in "GP", False, {"is_success": mark == "G"}

    def render(self) -> Any:
        self.drawn += 1
        return np.zeros((2, 2, 3), np.uint8)


def place(env: Any) -> Any:
    return env.at


def to_goal(env: Any) -> float:
    return float(abs(4 - env.at[0]) + abs(7 - env.at[1]))


def fresh(**options: Any) -> Walk:
    env = Walk(**options)
    env.reset(seed=3)
    return env


def won(env: Walk, actions: Any) -> bool:
    infos = [env.step(action)[4] for action in actions]
    return bool(infos[-1]["is_success"])


def test_a_copy_leaves_the_original_alone() -> None:
    env, model = fresh(gusts=0.5), Model()
    before = (env.at, [list(row) for row in env.seen], env.drawn, env.np_random.bit_generator.state)
    ghost = model.fork(env)
    for _ in range(20):
        model.play(ghost, MOVES[4])
    assert ghost.seen != env.seen
    assert (env.at, env.seen, env.drawn, env.np_random.bit_generator.state) == before
    assert model.spent == 20


def test_copies_of_copies_meet_the_same_chance() -> None:
    env, model = fresh(gusts=0.5), Model()
    first = model.fork(env)
    for _ in range(7):
        model.play(first, MOVES[4])
    second = model.fork(first)
    for _ in range(7):
        model.play(first, MOVES[2])
        model.play(second, MOVES[2])
    for _ in range(7):
        env.step((4, 0, 0))
    for _ in range(7):
        env.step((2, 0, 0))
    assert first.seen == second.seen == env.seen


def test_best_first_finds_the_shortest_way() -> None:
    env = fresh()
    found = best_first(Model(), env, lambda _: MOVES, to_goal, place, budget=1000)
    blind = best_first(Model(), env, lambda _: MOVES, lambda _: 0.0, place, budget=1000)
    assert found.reached
    assert len(found.actions) == len(blind.actions) == 15
    assert won(env, found.actions)


def test_an_estimate_saves_steps() -> None:
    env = fresh(rows=("S" + "." * 15, *["." * 16] * 3, "." * 7 + "G" + "." * 8, *["." * 16] * 5))
    guided, blind = Model(), Model()
    assert best_first(guided, env, lambda _: MOVES, to_goal, place, 1000).reached
    assert best_first(blind, env, lambda _: MOVES, lambda _: 0.0, place, 1000).reached
    assert guided.spent < blind.spent


def test_a_budget_ends_the_search_nearest_to_the_goal() -> None:
    env, model = fresh(), Model()
    found = best_first(model, env, lambda _: MOVES, to_goal, place, budget=40)
    assert not found.reached
    assert model.spent == 40
    assert to_goal(found.end) < to_goal(env)


def test_a_lost_state_is_no_goal() -> None:
    env = fresh(rows=("SPG",))
    found = best_first(Model(), env, lambda _: MOVES, to_goal, place, 100, goal=lambda ghost, _: ghost.at == (0, 1))
    assert not found.reached
    assert found.actions == ()


def test_macros_count_their_steps_and_stop_at_the_end() -> None:
    env, model = fresh(rows=("S.G.",)), Model()
    run: Macro = ((4, 0, 0),) * 5
    found = best_first(model, env, lambda _: [run], lambda _: 0.0, place, budget=100)
    assert found.reached
    assert model.spent == 2


def test_beam_avoids_a_loss_and_takes_a_win() -> None:
    env = fresh(rows=("SP", ".G"))
    found = beam(Model(), env, lambda _: MOVES, lambda ghost, _: ghost.at[1], depth=3, width=4, budget=200)
    assert found.reached
    assert found.actions == ((2, 0, 0), (4, 0, 0))


def test_beam_prefers_the_higher_value() -> None:
    env = fresh(rows=("S" + "." * 20,))
    found = beam(Model(), env, lambda _: MOVES, lambda ghost, _: ghost.at[1], 5, 3, 500, key=place)
    assert not found.reached
    assert found.actions == ((4, 0, 0),) * 5


def test_beam_without_a_survivor_is_empty() -> None:
    env = fresh(rows=("P",))
    assert beam(Model(), env, lambda _: MOVES, lambda *_: 0.0, 3, 2, 100).actions == ()


class Goes(Planner):
    def plan(self, env: Any) -> Any:
        return best_first(self.model, env, lambda _: MOVES, to_goal, place, 1000).actions


def test_a_planner_follows_its_plan() -> None:
    env, planner = fresh(), Goes()
    actions: list[Action] = []
    while not actions or not env.step(actions[-1])[2]:
        spent = planner.model.spent
        actions.append(planner.act(env))
        assert len(actions) == 1 or planner.model.spent == spent
    assert env.at == (4, 7)


def test_a_policy_is_one_text_without_envcraft(tmp_path: Path) -> None:
    file = tmp_path / "policy.py"
    file.write_text(
        "from __future__ import annotations\n\nfrom envcraft.demonstrations.planning import (\n    Planner,\n)\n\n"
        "class Waits(Planner):\n    def plan(self, env):\n        return [(0, 1, 0)]\n",
        "utf-8",
    )
    policy = policy_with_planning(file)
    assert "import envcraft" not in policy.source
    assert "from envcraft" not in policy.source
    module = types.ModuleType("policy")
    exec(compile(policy.source, "policy.py", "exec"), vars(module))
    assert module.Waits().act(fresh()) == (0, 1, 0)


def test_a_planner_without_a_plan_is_idle() -> None:
    class Lost(Planner):
        def plan(self, env: Any) -> Any:
            return ()

    assert Lost().act(fresh()) == (0, 0, 0)
    with pytest.raises(NotImplementedError):
        Planner().act(fresh())
