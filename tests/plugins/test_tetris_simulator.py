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
from envcraft_tetris.axes import clearing, controls
from envcraft_tetris.equivalence import compare
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
