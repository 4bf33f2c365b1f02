"""The benchmarks of speed and memory run with the smallest parameters, and detect broken limits."""

from __future__ import annotations

from dataclasses import replace

import pytest
from envcraft_sandbox.process import ProcessDriver

from benchmarks import boundary, cold, memory, overhead
from benchmarks.overhead import CHOSEN, Game, Measured, broken

BLINK = next(game for game in CHOSEN if game.name == "trivial")


@pytest.mark.parametrize("game", CHOSEN, ids=lambda game: game.name)
def test_each_game_has_the_same_length_bare_and_sandboxed(game: Game) -> None:
    short = replace(game, episodes=2, length=20)
    measured = overhead.measure(short, [ProcessDriver()])
    assert set(measured) == {"bare", "process"}
    for way in measured.values():
        assert way.steps == 40
        assert way.speed > 0
        # The CPU time includes the imports.
        assert way.cpu > 0.01


def test_the_sandbox_adds_to_a_trivial_step() -> None:
    measured = overhead.measure(replace(BLINK, episodes=1, length=300), [ProcessDriver()])
    assert measured["process"].speed < measured["bare"].speed


def test_limits() -> None:
    game = replace(BLINK, cpu=1.25, speed=0.85)
    bare = Measured(steps=10, speed=1000.0, cpu=1.0)
    assert not broken(game, {"bare": bare, "process": Measured(10, 860.0, 1.24)})
    assert len(broken(game, {"bare": bare, "process": Measured(10, 860.0, 1.26)})) == 1
    assert len(broken(game, {"bare": bare, "process": Measured(10, 840.0, 1.26)})) == 2


def test_limits_of_a_validation() -> None:
    assert not boundary.broken("process", "quick", 19.0, 1.14)
    assert not boundary.broken("docker", "standard", 74.0, None)
    assert len(boundary.broken("process", "quick", 21.0, 1.16)) == 2


def test_start_up_is_measured() -> None:
    assert 0 < cold.imports() < 60
    assert 0.01 < cold.start_up("process") < 60


def test_bare_speed() -> None:
    assert cold.bare_speed(BLINK.path, episodes=1) > 100


def test_the_first_round_does_not_count() -> None:
    taken = iter([9.0, 1.0, 2.0, 30.0])
    assert cold.in_turns({"it": lambda: next(taken)}, rounds=3) == {"it": [1.0, 2.0, 30.0]}


def test_the_peak_is_that_of_the_checker() -> None:
    mebibytes, steps = memory.peak(BLINK.path, "process", "quick")
    assert steps > 100
    assert 20 < mebibytes < memory.LIMIT_MIB
