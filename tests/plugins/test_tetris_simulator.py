"""The vectorized simulator of the family `tetris`, and its use by ``envcraft.make_vec``."""

from __future__ import annotations

import dataclasses
import importlib
import json
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numba  # noqa: TID253 (the simulator needs it)
import numpy as np
import pytest
from click.testing import CliRunner
from envcraft_tetris import placement
from envcraft_tetris.axes import clearing, controls
from envcraft_tetris.equivalence import Pair, actions, compare
from envcraft_tetris.family import TetrisFamily, variant_of
from envcraft_tetris.vectorized import pcg64
from envcraft_tetris.vectorized.vector import make_vec
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import envcraft
from envcraft.cli.commands.generate import generate
from envcraft.corpus.store import Store
from envcraft.environments.families import Family, Generated
from envcraft.environments.vector import NamedVectorEnv
from envcraft.errors import UsageError

COUNT = 6


@pytest.fixture(scope="module")
def generated() -> list[Generated]:
    return list(TetrisFamily().generate(40, 0))


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("tetris") / "games"
    arguments = ["--family", "tetris", "--count", str(COUNT), "--corpus", str(place)]
    assert CliRunner().invoke(generate, arguments).exit_code == 0
    return place


#: Compiled functions without wrappers are callable only from compiled code.
INTEGER: Any = numba.njit(lambda state, count: pcg64.integer(state, count))
PERMUTE: Any = numba.njit(lambda state, numbers, count: pcg64.permute(state, numbers, count))


def drawn_integers(state: Any, counts: list[int]) -> list[int]:
    return [INTEGER(state, count) for count in counts]


@pytest.mark.parametrize("seed", [0, 2**40 + 1])
def test_draws_match_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = np.array(pcg64.state_of(rng), np.uint64)
    # Counts above half of the range often reject the first draw; a count of 1 draws nothing.
    counts = [1, 2, 3, 7, 12, 2**31 + 1, *range(1, 60)] * 20
    assert drawn_integers(state, counts) == [int(rng.integers(count)) for count in counts]
    for count in (1, 2, 5, 7, 14, 18):
        numbers = np.zeros(18, np.int64)
        PERMUTE(state, numbers, count)
        assert numbers[:count].tolist() == rng.permutation(count).tolist()
    assert drawn_integers(state, [5] * 9) == rng.integers(5, size=9).tolist()
    assert pcg64.state_of(rng) == state.tolist()


def test_simulator_matches_sources(generated: list[Generated]) -> None:
    variants = [variant_of(one) for one in generated]
    assert {variant.clearing.rule for variant in variants} == set(clearing.RULES)
    events, differences = compare(generated, 200, 0)
    assert not differences
    assert events["steps"] > 7000
    assert events["episodes"] > 30
    assert events["cleared"] > 50


def test_comparison_detects_a_changed_rule(generated: list[Generated], monkeypatch: pytest.MonkeyPatch) -> None:
    """A difference that affects only a few steps is detected."""
    wrong = [dataclasses.replace(variant_of(one).gravity, fast=variant_of(one).gravity.fast + 1) for one in generated]
    changed = [
        dataclasses.replace(variant_of(one), gravity=gravity) for one, gravity in zip(generated, wrong, strict=True)
    ]
    monkeypatch.setattr("envcraft_tetris.family.variant_of", lambda one: changed[generated.index(one)])
    differing = {index for index, variant in enumerate(changed) if variant.gravity.schedule == "pulse"}
    _, differences = compare([generated[index] for index in sorted(differing)], 150, 0)
    assert len(differences) == len(differing)


def test_one_held_action_does_not_win_with_sand() -> None:
    sand = [one for one in TetrisFamily().generate(500, 0) if variant_of(one).clearing.rule == "sand"]
    assert len(sand) >= 10
    held = np.array([[move, first, second] for move in range(5) for first in range(2) for second in range(2)])
    episodes = 3
    copies = [one for one in sand for _ in range(len(held) * episodes)]
    simulator = TetrisFamily().simulate(copies, AutoresetMode.NEXT_STEP, copy=False)
    vector = NamedVectorEnv(simulator, [one.name for one in copies])
    won, over = np.zeros((2, len(copies)), np.bool_)
    vector.reset(seed=1)
    while not over.all():
        *_, terminated, truncated, infos = vector.step(np.tile(np.repeat(held, episodes, 0), (len(sand), 1)))
        won |= ~over & infos["is_success"]
        over |= terminated | truncated
    vector.close()
    assert won.reshape(len(sand), len(held), episodes).mean(2).max() < 0.9


def test_advice_rates_places_as_the_player_does(generated: list[Generated]) -> None:
    from envcraft_tetris.vectorized import advice

    simulator: Any = TetrisFamily().simulate(generated, AutoresetMode.NEXT_STEP, copy=False)
    vector = NamedVectorEnv(simulator, [one.name for one in generated])
    pairs = [Pair(one, simulator, index) for index, one in enumerate(generated)]
    rng = np.random.default_rng(3)
    result: Any = vector.reset(seed=0)
    for index, pair in enumerate(pairs):
        pair.reset(index, result, rng)
    games = [placement.Game(pair.env) for pair in pairs]
    compared = blocked = 0
    for step, action in zip(range(40), actions(rng, len(pairs)), strict=False):
        wanted = np.arange(len(pairs)) % 3 != step % 3
        ratings = advice.rate(simulator._rules, simulator._which, simulator._games, wanted)
        assert not ratings[~wanted].any()
        for index in np.flatnonzero(wanted & ~simulator._ended).tolist():
            expected = rated_by_the_player(games[index], pairs[index].env)
            stay = ratings[index][0]
            for one, other in zip(ratings[index].tolist(), expected, strict=True):
                # A piece that lands where it is, because it cannot move, is rated for the direction as well.
                blocked += int(one == stay and one != other)
                assert one == pytest.approx(other) or one == stay
                compared += 1
        result = vector.step(action)
        for pair in pairs:
            pair.step(action[pair._index], result, rng)
    assert compared > 2_000
    assert blocked < compared / 50


def rated_by_the_player(game: placement.Game, env: Any) -> list[float]:
    """The ratings of the best places that waiting, going left and going right lead to, by the policy of the player."""
    game.follow(env)
    ghost = game._ghost
    start, turn = dict(ghost.__dict__), ghost.turn
    game._note(ghost)
    board = game._bits(ghost.board)
    row = game._landing(board, ghost.kind, turn, ghost.row, ghost.column)
    best = [game._rate(board, ghost.kind, turn, row, ghost.column)]
    for direction in (3, 4):
        found: dict[tuple[int, int, int], Any] = {}
        game._steer(start, board, turn, direction, None, found)
        ratings = [game._rate(board, ghost.kind, *place) for place, moves in found.items() if moves]
        best.append(max(ratings, default=-np.inf))
    ghost.__dict__.update(start)
    return best


def test_advice_moves_pieces_where_they_fit(generated: list[Generated]) -> None:
    def cleared(advised: bool) -> int:
        simulator: Any = TetrisFamily().simulate(generated, AutoresetMode.NEXT_STEP, copy=False)
        everyone = np.ones(len(generated), np.bool_)
        rng = np.random.default_rng(0)
        simulator.reset(seed=0)
        found = 0
        for _ in range(400):
            probabilities = simulator.advise(everyone)
            assert probabilities.sum(1) == pytest.approx(1)
            assert set(np.flatnonzero(probabilities.any(0))) <= {0, 12, 16}
            joint = probabilities.argmax(1) if advised else rng.choice([12, 16], len(generated))
            before = simulator._games["cleared"].copy()
            simulator.step(np.stack(np.unravel_index(joint, (5, 2, 2)), 1))
            found += int((simulator._games["cleared"] - before).clip(0).sum())
        return found

    assert cleared(True) > 2.5 * cleared(False)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_matches_make_vec_without_the_simulator(corpus: Path, mode: AutoresetMode) -> None:
    names = [f"tetris_0_{number:04}" for number in range(COUNT)]
    ours: Any = envcraft.make_vec(names, 8, corpus=corpus, autoreset_mode=mode, fast=True)
    makers = [partial(envcraft.make, corpus, names[index % COUNT], trust=True) for index in range(8)]
    theirs: Any = SyncVectorEnv(makers, autoreset_mode=mode)
    for name in ("observation_space", "action_space", "single_observation_space", "single_action_space", "num_envs"):
        assert getattr(ours, name) == getattr(theirs, name), name
    assert ours.names[6] == "tetris_0_0000.py"
    assert_same(theirs.reset(seed=5), ours.reset(seed=5))
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(260):
        action = rng.integers(0, [5, 2, 2], (8, 3))
        found = theirs.step(action)
        assert_same(found, ours.step(action))
        ended = found[2] | found[3]
        ends += ended.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            options = {"reset_mask": ended}
            assert_same(theirs.reset(options=dict(options)), ours.reset(options=options))
    assert ends >= 5
    assert_same(theirs.render(), ours.render())
    ours.close()


def assert_same(one: Any, two: Any) -> None:
    """Compare values and dtypes, recursively."""
    if isinstance(one, dict):
        assert set(one) == set(two)
        for key in one:
            assert_same(one[key], two[key])
    elif isinstance(one, tuple):
        for left, right in zip(one, two, strict=True):
            assert_same(left, right)
    elif isinstance(one, np.ndarray):
        assert one.dtype == two.dtype
        assert all(np.array_equal(left, right) for left, right in zip(one, two, strict=True))
    else:
        assert one == two


class TestMakeVec:
    def test_variants_without_a_corpus(self, generated: list[Generated]) -> None:
        variants = [variant_of(one) for one in generated[:2]]
        vector = make_vec(variants, 3, autoreset_mode="SameStep")
        frames, info = vector.reset(seed=[1, 2, 1])
        assert vector.names[0] == variants[0].title
        assert np.array_equal(frames[0], frames[2])
        assert not np.array_equal(frames[0], frames[1])
        assert info["steps"].tolist() == [0, 0, 0]

    def test_shared_observations_are_read_only(self, generated: list[Generated]) -> None:
        vector = make_vec([variant_of(generated[0])], copy=False)
        frames, _ = vector.reset(seed=0)
        before = frames.copy()
        for _ in range(10):
            vector.step(np.zeros((1, 3), np.int64))
        assert not np.array_equal(frames, before)
        with pytest.raises(ValueError, match="read-only"):
            frames[0] = 0

    def test_a_changed_source_is_refused(self, corpus: Path) -> None:
        with Store(corpus, write=True) as store, store.transaction():
            sha256, origin = store.db.execute(
                "SELECT source, origin FROM environments WHERE name = 'tetris_0_0001.py'"
            ).fetchone()
            text = store.source(sha256).replace(b"MAX_STEPS = 1000", b"MAX_STEPS = 1001")
            store.add("changed.py", text, origin=json.loads(origin))
            store.add("stray.py", store.source(sha256))
        with pytest.raises(UsageError, match="the source of changed is not what this version"):
            envcraft.make_vec(["tetris_0_0001", "changed"], corpus=corpus, fast=True)
        with pytest.raises(UsageError, match=r"not stray\.py"):
            envcraft.make_vec(["tetris_0_0001", "stray"], corpus=corpus, fast=True)
        with pytest.raises(UsageError, match="arcade-native has one"):
            envcraft.make_vec(["tetris_0_0001"], corpus=corpus, contract="arcade-native", fast=True)
        with pytest.raises(UsageError, match="takes no sandbox"):
            envcraft.make_vec(["tetris_0_0001"], corpus=corpus, sandbox="auto", fast=True)

    def test_unknown_axis_values_are_refused(self, generated: list[Generated]) -> None:
        variant = variant_of(generated[0])
        other = dataclasses.replace(variant, controls=controls.Controls("", "", "cw", "leap", "once"))
        for axes in (None, {}, other.axes(), {**variant.axes(), "board": {"rows": "many"}}):
            with pytest.raises(UsageError, match="omit fast"):
                variant_of(dataclasses.replace(generated[0], metadata={"axes": axes}))

    def test_missing_simulator_and_missing_numba_are_reported(
        self, generated: list[Generated], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        class Plain(Family):
            name = "plain"

            def generate(self, count: int, seed: int, difficulty: float | None = None) -> Iterator[Generated]:
                return iter(generated)

        with pytest.raises(UsageError, match="the family plain has no simulator"):
            Plain().simulate(generated, AutoresetMode.NEXT_STEP, copy=True)
        monkeypatch.setitem(sys.modules, "numba", None)
        monkeypatch.delitem(sys.modules, "envcraft_tetris.vectorized.jit")
        with pytest.raises(UsageError, match=r"pip install 'envcraft-rl\[train\]'"):
            importlib.import_module("envcraft_tetris.vectorized.jit")
