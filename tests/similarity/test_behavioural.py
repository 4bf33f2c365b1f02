"""What environments do: the same however they are written, other games apart, broken ones nothing at all."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from envcraft_sandbox.process import ProcessDriver

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.target import Target
from envcraft.similarity import behavioural
from envcraft.similarity.behavioural import EVERY, Series
from tests.similarity.games import game, renamed

#: The game 0, written anew: another layout of the state, another drawing, and the same to look at.
REWRITTEN = b"""
import gymnasium
import numpy


class Harvest(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
    observation_space = gymnasium.spaces.Box(0, 255, (84, 84, 3), numpy.uint8)
    action_space = gymnasium.spaces.MultiDiscrete([5, 2, 2])

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        gymnasium.Env.reset(self, seed=seed)
        self.field = self.np_random.integers(0, 3, (12, 12))
        self.where = numpy.array([5, 5])
        self.left, self.found, self.time = 3, 0, 0
        return self.render(), self.told()

    def told(self):
        return {"score": self.found, "lives": self.left, "is_success": self.found >= 10}

    def step(self, action):
        self.time += 1
        way = numpy.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]])[action[0]]
        self.where = numpy.clip(self.where + way, 0, 11)
        spot = tuple(self.where)
        won = self.field[spot] == 2
        if won:
            self.found += 1
            self.field[spot] = 0
        row, rest = divmod(self.time % 97, 8)
        if not rest and 0 < row < 12 and self.field[row, 7] == 2:
            self.left -= row & 1
        over = self.left <= 0
        return self.render(), float(won), bool(over), bool(not over and self.time >= 500), self.told()

    def render(self):
        picture = numpy.kron(self.field[:, :, None] * 40, numpy.ones((7, 7, 1))).repeat(3, axis=2).astype(numpy.uint8)
        row, column = self.where * 7
        picture[row : row + 7, column : column + 7] = numpy.array([250, 80, 60])
        return picture
"""


def series(frames: list[int], rewards: list[float], end: int = 0, steps: int | None = None) -> Series:
    steps = EVERY * len(rewards) if steps is None else steps
    return Series(b"script", end, steps, np.array(frames, "<u8"), np.array(rewards, "<f4"))


def some(seed: int, length: int = 9) -> Series:
    rng = np.random.default_rng(seed)
    return series([int(n) for n in rng.integers(1, 2**63, length)], [float(n) for n in rng.integers(0, 2, length - 1)])


@pytest.fixture(scope="module")
def played() -> dict[str, str]:
    """The fingerprints of some games, from the sandbox."""
    still = game(1).replace(b"return frame", b"return frame * 0")
    quiet = game(2).replace(b"self.score - before", b"0")
    sources = {
        "game": game(0), "renamed": renamed(game(0)), "rewritten": REWRITTEN, "other": game(5),
        "paid more": game(0).replace(b"float(self.score - before)", b"2.0 * (self.score - before)"),
        "black": still, "black, other": still.replace(b"self.score +=", b"self.score -="), "unpaid": quiet,
        "raises": game(0).replace(b"self.steps += 1", b"self.steps += 1 // (self.steps < 9)"),
    }  # fmt: skip
    found = {}
    for name, source in sources.items():
        lease = WorkerPool(ProcessDriver()).lease()
        with Subject(Target(f"{name}.py", source), ARCADE, lease, BUDGETS["quick"]) as subject:
            assert subject.fingerprint == ""
            subject.rollout(subject.probes.random(0))
            assert subject.fingerprint == ""
            subject.rollout(subject.probes.sticky(0))
            found[name] = subject.fingerprint
    return found


def test_the_same_game_however_it_is_written(played: dict[str, str]) -> None:
    names = ["game", "renamed", "rewritten", "other", "paid more", "unpaid"]
    known = [behavioural.read(played[name]) for name in names]
    assert all(known)
    found = [one for one in known if one is not None]
    joined = {frozenset(pair) for pair in behavioural.pairs(found)}
    assert joined == {frozenset(pair) for pair in ((0, 1), (0, 2), (1, 2))}
    assert len({one.script for one in found}) == 1
    assert found[0].steps > behavioural.FEWEST


def test_uninformative_episode_has_no_key(played: dict[str, str]) -> None:
    assert played["black"]
    assert behavioural.read(played["black"]) is None
    assert behavioural.read(played["black, other"]) is None
    assert played["raises"] == ""


def test_fingerprints_are_small(played: dict[str, str]) -> None:
    assert max(map(len, played.values())) < 1200


@pytest.mark.parametrize(
    ("what", "informative"),
    [
        (some(0), True),
        (series([5] * 9, [0.0] * 8), False),
        (series([5] * 9, [0.0] * 7 + [1.0]), True),
        (series([0] * 5 + [1, 2, 3, 4], [float(n) for n in range(8)]), False),
        (series([1, 2], [0.5], 1, 4), False),
    ],
    ids=["some", "still", "paid once", "blank", "short"],
)
def test_informative(what: Series, informative: bool) -> None:
    assert what.informative is informative


@pytest.mark.parametrize(
    "text",
    [
        "",
        "!",
        "AAAA",
        base64.b64encode(b"\x01" * 40).decode(),
        base64.b64encode(b"\x09" * 14).decode(),
        # Of no steps: one frame, and nothing that was paid.
        base64.b64encode(behavioural._HEAD.pack(1, 1, 0, 1, b"12345678") + b"\x05" * 8).decode(),
    ],
)
def test_what_is_no_fingerprint_is_read_as_none(text: str) -> None:
    assert behavioural.read(text) is None


def test_ends_and_lengths_are_part_of_the_behaviour() -> None:
    one = some(0)
    other_end = Series(one.script, 1, one.steps, one.frames, one.rewards)
    other_script = Series(b"another", 0, one.steps, one.frames, one.rewards)
    shorter = series(one.frames.tolist()[:-1], one.rewards.tolist()[:-1])
    assert list(behavioural.pairs([one, other_end, other_script, shorter])) == []
    assert list(behavioural.pairs([one, one])) == [(0, 1)]


def test_frames_agree_in_nineteen_of_twenty_bits() -> None:
    one = some(0)
    few, many = one.frames.copy(), one.frames.copy()
    few ^= np.uint64(0b111)
    many ^= np.uint64(0b11111)
    alike = [one] + [Series(one.script, one.end, one.steps, frames, one.rewards) for frames in (few, many)]
    assert (0, 1) in list(behavioural.pairs(alike))
    assert (0, 2) not in list(behavioural.pairs(alike))


def test_the_kernel_is_one() -> None:
    found = [some(seed, 5 + seed % 9) for seed in range(40)] + [some(0, 5)]
    found.append(Series(b"another", 0, found[0].steps, found[0].frames, found[0].rewards))
    measured = behavioural.kernel(found)
    assert np.allclose(np.diag(measured), 1)
    assert measured[0, 40] == pytest.approx(1)
    assert measured[0, 41] == 0
    assert np.linalg.eigvalsh(measured).min() > -1e-9
    assert measured[0, 1:40].max() < 0.6
