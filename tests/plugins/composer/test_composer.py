"""The family `composer`: what fits together, the sources, and the player."""

from __future__ import annotations

import ast
import types
from collections import Counter
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from envcraft_composer.composition import GROUPS, Composition, combinations, cores
from envcraft_composer.family import ComposerFamily
from envcraft_composer.mechanic import Mechanic, fits, traits
from envcraft_composer.policy import Composed

from envcraft.cli.group import cli
from envcraft.environments.families import Generated
from envcraft.similarity import near, structural
from envcraft.similarity.groups import Groups
from tests.plugins.composer.composed import load

#: As many games as there are goals, one for each.
GOALS = [mechanic.name for mechanic in GROUPS["goal"]]


def games(count: int, difficulty: float | None = 0.5) -> list[Generated]:
    return list(ComposerFamily().generate(count, 0, difficulty))


@cache
def many() -> list[Generated]:
    return games(150, None)


@cache
def first() -> dict[str, Generated]:
    """The first game of each goal."""
    return {game.metadata["axes"]["goal"]: game for game in reversed(games(3 * len(GOALS)))}


@pytest.fixture
def game(goal: str) -> Generated:
    return first()[goal]


BY_GOAL = pytest.mark.parametrize("goal", GOALS)


def play(env: Any, seed: int, choose: Any) -> tuple[int, bool, float]:
    env.reset(seed=seed)
    total = 0.0
    while True:
        _, reward, terminated, truncated, info = env.step(choose())
        total += reward
        if terminated or truncated:
            assert isinstance(info["is_success"], bool)
            assert env.steps <= 1000
            return env.steps, info["is_success"], total


def test_mechanics_fit_by_their_traits() -> None:
    water = Mechanic("water", "", gives=traits("wet"))
    boat = Mechanic("boat", "", needs=traits("wet"))
    car = Mechanic("car", "", bars=traits("wet"))
    assert fits([water, boat])
    assert not fits([boat])
    assert not fits([water, car])
    assert not fits([Mechanic("self", "", gives=traits("wet"), needs=traits("wet"))])


def test_mechanics_combine_into_thousands_of_games() -> None:
    every = cores()
    bricks = [core for core in every if core["goal"].name == "bricks"]
    found = [chosen for core in every[::20] + bricks for chosen in combinations(core)]
    assert len(found) >= 3000
    for group, mechanics in GROUPS.items():
        names = {chosen[group].name for chosen in (every if group in every[0] else found)}
        assert names == {mechanic.name for mechanic in mechanics}
        assert len(names) == len(mechanics)


def test_the_first_games_have_all_goals_and_many_worlds_and_avatars() -> None:
    axes = [game.metadata["axes"] for game in many()[:60]]
    assert len(first()) == len(GOALS) >= 12
    assert len({one["world"] for one in axes}) >= 10
    assert len({one["avatar"] for one in axes}) >= 10
    assert len({one["twist"] for one in axes}) >= 12
    assert len({tuple(one[group] for group in GROUPS) for one in axes}) == 60


def test_goals_have_equal_shares_until_their_sets_run_out() -> None:
    goals = Counter(game.metadata["axes"]["goal"] for game in many())
    # One world, avatar and goal make all games of bricks, and crates and drops are much code.
    assert all(goals[goal] >= 9 for goal in GOALS if goal not in ("bricks", "crates", "merge")), goals
    assert goals["crates"] >= 4
    assert goals["merge"] >= 4


def test_generation_is_deterministic_and_a_smaller_count_is_a_part() -> None:
    five = games(5)
    assert games(8)[:5] == five
    other = list(ComposerFamily().generate(5, 1))
    assert not {game.source for game in other} & {game.source for game in five}


def test_no_two_sources_have_the_same_structure() -> None:
    keys = [structural.key(game.source.encode()) for game in many()]
    assert len(set(keys)) == len(many())


def test_no_two_sources_are_near_duplicates() -> None:
    keys = [near.key(game.source.encode()) for game in many()]
    sets = [found for found in near.own([near.shingles(key) for key in keys if key]) if found is not None]
    assert len(sets) == len(many())
    assert list(near.pairs(sets, near.THRESHOLD, Groups(len(sets)))) == []


def test_all_sources_have_80_to_250_lines() -> None:
    lines = [game.source.count("\n") for game in many()]
    assert min(lines) >= 80
    assert max(lines) <= 250


@BY_GOAL
def test_sources_are_short_files_that_explain_themselves(game: Generated) -> None:
    assert max(map(len, game.source.splitlines())) <= 120
    tree = ast.parse(game.source)
    text = ast.get_docstring(tree) or ""
    assert "Goal:" in text
    assert "Controls:" in text
    assert "Rewards:" in text
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert imported <= {"__future__", "typing", "gymnasium", "numpy"}


@BY_GOAL
def test_random_play_and_doing_nothing_keep_the_contract(game: Generated) -> None:
    env = load(game.source)
    rng = np.random.default_rng(0)
    frame, info = env.reset(seed=1)
    assert info["is_success"] is False
    assert env.observation_space.contains(frame)
    assert env.get_state()["remaining"] == env.total > 0
    _, _, total = play(env, 2, lambda: rng.integers(0, [5, 2, 2]))
    assert abs(total) < 100
    steps, won, _ = play(env, 3, lambda: (0, 0, 0))
    assert steps > 30
    assert not won


@BY_GOAL
def test_nothing_changes_after_the_end(game: Generated) -> None:
    env = load(game.source)
    play(env, 3, lambda: (0, 0, 0))
    frames = [env.step((move, 1, 0))[0] for move in range(5)]
    assert all((frame == frames[0]).all() for frame in frames)


@BY_GOAL
def test_the_player_wins(game: Generated) -> None:
    env = load(game.source)
    for seed in range(4):
        player = Composed()
        steps, won, _ = play(env, seed, lambda player=player: player.act(env))
        if won:
            assert player.model.spent >= steps // 4
            return
    pytest.fail("no win in 4 episodes")


def test_a_harder_game_has_more_to_do_in_less_time() -> None:
    levels = [games(40, difficulty) for difficulty in (0.0, 0.5, 1.0)]
    for easy, middle, hard in zip(*levels, strict=True):
        assert [game.metadata["axes"]["goal"] for game in (easy, middle)] == [hard.metadata["axes"]["goal"]] * 2
        counts = [game.metadata["axes"]["constants"].get("COUNT", 0) for game in (easy, middle, hard)]
        assert counts == sorted(counts)


def test_every_combination_defines_the_constants_that_it_uses() -> None:
    for number, core in enumerate(cores()[::9]):
        found = combinations(core)
        chosen = found[37 * number % len(found)]
        composition = Composition.draw(Random(1), chosen, 0.5)
        source = composition.write("Game")
        assert "<<" not in source
        constants = {
            node.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name) and node.id.isupper()
        }
        defined = types.ModuleType("composed")
        exec(compile(source, "composed.py", "exec"), vars(defined))
        assert constants <= set(vars(defined))


def judge(*words: object) -> Result:
    return CliRunner().invoke(cli, ["validate", "--budget", "quick", "--sandbox", "process", *map(str, words)])


def test_games_pass_the_checks(tmp_path: Path) -> None:
    for game in (first()[GOALS[0]], first()[GOALS[8]]):
        (tmp_path / f"{game.name}.py").write_text(game.source, "utf-8")
    result = judge(tmp_path)
    assert result.exit_code == 0, result.output


def test_the_player_is_a_policy_that_runs_in_the_sandbox(tmp_path: Path) -> None:
    file = tmp_path / "game.py"
    file.write_text(first()[GOALS[0]].source, "utf-8")
    result = judge(file, "--checks", "difficulty", "--policy", "composer", "--strict")
    assert result.exit_code == 0, result.output
    unknown = judge(file, "--checks", "difficulty", "--policy", "composed")
    assert unknown.exit_code == 2
    assert "the policy composed cannot be read" in unknown.output


def test_the_description_of_a_number_that_is_one_is_singular() -> None:
    about = [" ".join(game.source.split('"""')[1].split()) for game in ComposerFamily().generate(300, 0)]
    assert any("stray about in every step." in text for text in about)
    assert not any("in every 1." in text or " 1 cells" in text for text in about)
