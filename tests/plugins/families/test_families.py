"""The small families: what is generated, how it plays, and how hard it is."""

from __future__ import annotations

import ast
import dataclasses
import json
import types
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from click.testing import CliRunner
from envcraft_checks.imports import required_imports
from envcraft_families.families import families
from envcraft_families.players import players
from envcraft_families.variant import VariantFamily

from envcraft.cli.group import cli
from envcraft.corpus.store import Store
from envcraft.environments.families import Generated
from envcraft.errors import UsageError
from envcraft.similarity import structural

ALL = {family.name: family for family in families()}
PLAYERS = {player.name: player for player in players()}
each_family = pytest.mark.parametrize("family", ALL.values(), ids=list(ALL))


def load(source: str) -> Any:
    """The environment of a source that this repository's own templates made."""
    module = types.ModuleType("variant")
    exec(compile(source, "variant.py", "exec"), vars(module))
    (env_class,) = [found for found in vars(module).values() if isinstance(found, type) and issubclass(found, gym.Env)]
    return env_class()


def policy(name: str) -> Any:
    """The policy of a player, from the text that runs in the sandbox."""
    file = PLAYERS[name].policy
    assert file is not None
    module = types.ModuleType("policy")
    exec(compile(file.source, file.path, "exec"), vars(module))
    found = [value for value in vars(module).values() if isinstance(value, type) and callable(getattr(value, "act", 0))]
    return found[-1]()


def play(env: Any, seed: int, act: Any) -> tuple[int, bool, list[float], list[bytes]]:
    """The steps of an episode, whether it is won, its rewards and its frames."""
    frame, _ = env.reset(seed=seed)
    rewards: list[float] = []
    frames = [frame.tobytes()]
    while True:
        frame, reward, terminated, truncated, info = env.step(act())
        rewards.append(reward)
        frames.append(frame.tobytes())
        if terminated or truncated:
            assert type(info["is_success"]) is bool
            assert terminated != truncated
            return len(rewards), info["is_success"], rewards, frames


def random_play(env: Any, seed: int) -> tuple[int, bool, list[float], list[bytes]]:
    rng = np.random.default_rng(seed)
    return play(env, seed, lambda: rng.integers(0, [5, 2, 2]))


class TestGenerated:
    @each_family
    def test_the_same_seed_gives_the_same_and_fewer_the_first_of_them(self, family: VariantFamily) -> None:
        found = list(family.generate(15, 0))
        assert list(family.generate(5, 0)) == found[:5]
        assert not {one.source for one in family.generate(15, 1)} & {one.source for one in found}
        assert len({structural.key(one.source.encode()) for one in found}) == 15
        assert len({one.name for one in found}) == 15

    @each_family
    def test_each_is_one_plain_readable_file(self, family: VariantFamily) -> None:
        for one in family.generate(30, 0):
            tree = ast.parse(one.source)
            assert set(required_imports(tree)) == {"__future__", "typing", "gymnasium", "numpy"}
            docstring = ast.get_docstring(tree) or ""
            assert all(part in docstring for part in ("Goal: ", "Controls: ", "Rewards: ")), one.name
            assert "<<" not in one.source
            assert max(map(len, one.source.splitlines())) <= 120
            assert 80 <= one.source.count("\n") <= 250, one.name
            json.dumps(one.metadata)

    @each_family
    def test_variants_differ_along_each_axis(self, family: VariantFamily) -> None:
        """Each value of an axis comes, and a value that is changed alone makes another program."""
        found = [one.metadata["axes"] for one in family.generate(200, 0)]
        fields = [
            field.name for field in dataclasses.fields(family.variant) if field.name not in ("difficulty", "look")
        ]
        assert len(fields) >= 7
        for name in fields:
            values = {json.dumps(axes[name]) for axes in found}
            assert len(values) > 1, name
        assert len(family.variant.axes) >= 7

    @each_family
    def test_changing_one_axis_changes_the_program(self, family: VariantFamily) -> None:
        from random import Random

        drawn = [family.variant.draw(Random(f"{number}"), 0.6) for number in range(30)]
        base = drawn[0]
        for field in dataclasses.fields(base):
            others = [
                getattr(one, field.name) for one in drawn if getattr(one, field.name) != getattr(base, field.name)
            ]
            if field.name != "difficulty":
                changed = dataclasses.replace(base, **{field.name: others[0]})
                assert changed.write("Game") != base.write("Game"), field.name


class TestPlay:
    @each_family
    def test_play_repeats_and_rewards_are_bounded(self, family: VariantFamily) -> None:
        for one in family.generate(2, 3):
            first, again = random_play(load(one.source), 5), random_play(load(one.source), 5)
            assert first == again
            assert random_play(load(one.source), 6)[3][0] != first[3][0] or first[0] > 1
            assert all(np.isfinite(first[2]))
            assert max(map(abs, first[2])) <= 100

    @each_family
    def test_doing_nothing_neither_wins_nor_ends_at_once(self, family: VariantFamily) -> None:
        for one in family.generate(4, 4):
            steps, won, _, _ = play(load(one.source), 0, lambda: (0, 0, 0))
            assert steps >= 40, one.name
            assert not won, one.name

    @each_family
    def test_the_player_wins_and_random_play_does_not(self, family: VariantFamily) -> None:
        won, lucky = [], []
        for one in family.generate(4, 0):
            env, player = load(one.source), policy(family.name)
            won.append(play(env, 0, lambda env=env, player=player: player.act(env))[1])
            lucky += [random_play(env, seed)[1] for seed in range(4)]
        assert sum(won) >= 3
        assert np.mean(lucky) <= 0.3

    @each_family
    def test_the_state_is_plain_data_and_no_part_of_the_game(self, family: VariantFamily) -> None:
        one = next(iter(family.generate(1, 0)))
        env = load(one.source)
        env.reset(seed=0)
        before = repr(env.get_state())
        for value in env.get_state().values():
            if isinstance(value, list | dict):
                value.clear()
        assert repr(env.get_state()) == before


class TestDifficulty:
    @each_family
    def test_a_higher_difficulty_needs_more_steps(self, family: VariantFamily) -> None:
        steps = []
        for difficulty in (0.0, 0.5, 1.0):
            lengths = []
            for one in family.generate(3, 0, difficulty):
                player, env = policy(family.name), load(one.source)
                length, won, _, _ = play(env, 1, lambda env=env, player=player: player.act(env))
                lengths += [length] if won else []
            steps.append(np.mean(lengths))
        assert steps == sorted(steps)
        assert steps[2] > 1.3 * steps[0]

    @each_family
    def test_a_number_has_the_same_choices_at_every_difficulty(self, family: VariantFamily) -> None:
        easy, hard = (list(family.generate(5, 0, difficulty)) for difficulty in (0.0, 1.0))
        for one, other in zip(easy, hard, strict=True):
            assert {**one.metadata["axes"], "difficulty": 1.0} == other.metadata["axes"]
            assert one.name != other.name

    def test_families_without_a_difficulty_say_who_has_one(self, tmp_path: Path) -> None:
        arguments = ["generate", "--family", "snake,tetris", "--difficulty", "0.5", "--output", str(tmp_path / "games")]
        result = CliRunner().invoke(cli, arguments)
        assert result.exit_code == 2
        assert "the family tetris has no --difficulty; the families with a difficulty are" in result.stderr
        assert all(name in result.stderr for name in ALL)
        assert not (tmp_path / "games").exists()


class TestCommand:
    def test_a_mixed_corpus_and_its_split(self, tmp_path: Path) -> None:
        corpus = str(tmp_path / "corpus")
        names = ",".join(ALL)
        arguments = ["generate", "--family", names, "--count", "3", "--difficulty", "0.25", "--corpus", corpus]
        result = CliRunner().invoke(cli, arguments)
        assert result.exit_code == 0, result.stderr
        assert result.stdout.startswith(f"wrote {3 * len(ALL)}, kept 0")
        with Store(Path(corpus)) as store:
            origins = [json.loads(row[0]) for row in store.db.execute("SELECT origin FROM environments")]
        assert sorted(origin["family"] for origin in origins) == sorted([*ALL] * 3)
        assert {origin["difficulty"] for origin in origins} == {0.25}
        result = CliRunner().invoke(cli, ["corpus", "split", corpus, "--by", "family"])
        assert result.exit_code == 0, result.stderr
        splits = json.loads(result.stdout)["splits"]
        assert sorted(part["families"] for part in splits) == sorted([name] for name in ALL)
        assert all(len(part["environments"]) == 3 for part in splits)

    def test_a_family_twice_is_a_usage_error(self, tmp_path: Path) -> None:
        result = CliRunner().invoke(cli, ["generate", "--family", "snake,snake", "--output", str(tmp_path)])
        assert result.exit_code == 2
        assert "names snake twice" in result.stderr


def test_the_player_of_the_shooter_aims_from_where_its_move_leads() -> None:
    env = load(list(ALL["shooter"].generate(60, 0))[59].source)
    policies = {seed: policy("shooter") for seed in (2, 6)}
    assert all(play(env, seed, lambda seed=seed: policies[seed].act(env))[1] for seed in policies)


@each_family
def test_judged_at_quick_without_findings(family: VariantFamily, tmp_path: Path) -> None:
    written: list[Generated] = list(family.generate(1, 0))
    for one in written:
        (tmp_path / f"{one.name}.py").write_text(one.source)
    arguments = ["validate", str(tmp_path), "--sandbox", "process", "--budget", "quick", "--format", "json"]
    result = CliRunner().invoke(cli, [*arguments, "--workers", "1"])
    reports = json.loads(result.stdout)["reports"]
    found = [
        (report["path"], finding["code"])
        for report in reports
        for check in report["checks"]
        for finding in check["findings"]
    ]
    assert not found
    assert len(reports) == len(written)


def test_unknown_families_are_named() -> None:
    from envcraft.environments.families import families_named

    with pytest.raises(UsageError, match="did you mean snake"):
        families_named("maze,snak")
