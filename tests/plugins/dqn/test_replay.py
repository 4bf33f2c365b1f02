"""The replay, compared with a reference that stores whole episodes and computes every return directly."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from envcraft_dqn.frames import RawFrames
from envcraft_dqn.replay import Replay, decisiveness
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

SHAPE = (1, 2, 3)
GAMMA = 0.9


def frame(number: int) -> NDArray[np.uint8]:
    """A frame that tells its number."""
    return np.frombuffer(number.to_bytes(6, "little"), np.uint8).reshape(SHAPE)


def number(frame: NDArray[np.uint8]) -> int:
    return int.from_bytes(frame.tobytes(), "little")


@dataclass
class Episode:
    """What one lane saw: the numbers of its frames, one more than there are rewards."""

    frames: list[int]
    rewards: list[float] = field(default_factory=list)
    ended: str = ""


def expected(episodes: list[Episode], n: int) -> dict[int, tuple[float, float, int | None]]:
    """Return, discount and next frame of each transition that can be drawn, by the number of its first frame."""
    found: dict[int, tuple[float, float, int | None]] = {}
    for episode in episodes:
        length = len(episode.rewards)
        for step in range(length):
            last = min(step + n, length)
            total = sum(GAMMA ** (at - step) * episode.rewards[at] for at in range(step, last))
            if last == length and episode.ended == "terminated":
                found[episode.frames[step]] = (total, 0.0, None)
            else:
                # Play ends with a cut, so every episode that has a reward has an end.
                found[episode.frames[step]] = (total, GAMMA ** (last - step), episode.frames[last])
    return found


def play(
    replay: Replay, rng: np.random.Generator, lanes: int, steps: int, first: int, chance: float = 0.15
) -> tuple[list[Episode], int]:
    """Step `lanes` lanes that end at random; some stand still now and then, as after an end."""
    episodes: list[Episode] = []
    replay.reset(lanes)
    current: list[Episode | None] = [None] * lanes
    for _ in range(steps):
        on = []
        for lane in range(lanes):
            if current[lane] is None:
                current[lane] = Episode([first])
                episodes.append(current[lane])  # type: ignore[arg-type]
                first += 1
            elif rng.random() < 0.9 or current[lane].rewards:  # type: ignore[union-attr]
                on.append(lane)
        if not on:
            continue
        playing = [episode for lane in on if (episode := current[lane]) is not None]
        before = np.stack([frame(episode.frames[-1]) for episode in playing])
        rewards = rng.normal(size=len(on))
        ends = rng.random(len(on))
        terminated, truncated = ends < chance / 2, (ends >= chance / 4) & (ends < chance)
        for place, (lane, episode) in enumerate(zip(on, playing, strict=True)):
            episode.frames.append(first)
            episode.rewards.append(float(rewards[place]))
            first += 1
            if terminated[place] or truncated[place]:
                # Both at once is a termination.
                episode.ended = "terminated" if terminated[place] else "truncated"
                current[lane] = None
        after = np.stack([frame(episode.frames[-1]) for episode in playing])
        actions = np.array([episode.frames[-2] % 20 for episode in playing])
        replay.add(np.array(on), before, actions, rewards, terminated, truncated, after)
    standing = np.stack([frame(0 if episode is None else episode.frames[-1]) for episode in current])
    replay.truncate(np.arange(lanes), standing)
    for episode in current:
        if episode is not None and episode.rewards:
            episode.ended = "cut"
    return episodes, first


def drawable(replay: Replay) -> NDArray[np.int64]:
    return np.flatnonzero(replay._tree.leaves)


def held(replay: Replay, slots: NDArray[np.int64]) -> dict[int, tuple[float, float, int | None]]:
    """What the replay has in these slots, in the form of :func:`expected`."""
    frames = replay._store.read(slots).copy()
    following = replay._store.read(replay._next[slots]).copy()
    return {
        number(frames[at]): (
            float(replay._returns[slot]),
            float(replay._discounts[slot]),
            None if replay._discounts[slot] == 0 else number(following[at]),
        )
        for at, slot in enumerate(slots)
    }


def agree(mine: tuple[float, float, int | None], theirs: tuple[float, float, int | None]) -> bool:
    return mine[2] == theirs[2] and mine[:2] == pytest.approx(theirs[:2], rel=1e-5, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32), st.integers(1, 6), st.integers(1, 5), st.integers(1, 60), st.sampled_from([0.05, 0.3, 1.0])
)
def test_n_step_returns_are_those_of_whole_episodes(seed: int, lanes: int, n: int, steps: int, chance: float) -> None:
    replay = Replay(RawFrames(2000, SHAPE), 2000, n, GAMMA)
    episodes, _ = play(replay, np.random.default_rng(seed), lanes, steps, 1, chance)
    wanted = expected(episodes, n)
    found = held(replay, drawable(replay))
    assert found.keys() == wanted.keys()
    assert all(agree(found[key], wanted[key]) for key in wanted)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 5), st.integers(1, 4), st.integers(0, 40))
def test_a_ring_keeps_the_newest_and_the_demonstrations(seed: int, lanes: int, n: int, kept: int) -> None:
    rng = np.random.default_rng(seed)
    size = 60 + kept
    replay = Replay(RawFrames(size, SHAPE), size, n, GAMMA)
    demonstrated, first = play(replay, rng, 1, kept // 2, 1)
    before = held(replay, drawable(replay))
    assert before.keys() == expected(demonstrated, n).keys()
    replay.protect()
    episodes, _ = play(replay, rng, lanes, 80, first)
    wanted = {**expected(demonstrated, n), **expected(episodes, n)}
    found = held(replay, drawable(replay))
    # Whatever can be drawn is right, though most was overwritten; demonstrations are all there.
    assert all(agree(found[key], wanted[key]) for key in found)
    assert before.keys() <= found.keys()
    ring = sorted(key for key in found if key >= first)
    newest = sorted(key for key in expected(episodes, n) if key >= first)
    # In each lane the newest are there; lanes take turns, so all are newer than what is gone.
    assert len(ring) >= min(len(newest), (size - replay.kept) // 2 - lanes)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 5), st.integers(1, 12), st.booleans())
def test_an_episode_at_once_is_the_same_as_step_by_step(seed: int, n: int, steps: int, terminated: bool) -> None:
    rng = np.random.default_rng(seed)
    frames = np.stack([frame(at) for at in range(steps + 1)])
    actions, rewards = rng.integers(0, 20, steps), rng.normal(size=steps)
    one, other = (Replay(RawFrames(60, SHAPE), 60, n, GAMMA) for _ in range(2))
    one.add_episode(frames, actions, rewards, terminated, actions)
    other.reset(1)
    for at in range(steps):
        ends = np.array([at == steps - 1])
        how = ends & terminated, ends & (not terminated)
        other.add(
            np.zeros(1, int), frames[at][None], actions[at : at + 1], rewards[at : at + 1], *how, frames[at + 1][None]
        )
    assert one.added == other.added
    assert one.drawable == other.drawable == steps
    theirs = held(other, drawable(other))
    assert all(agree(value, theirs[key]) for key, value in held(one, drawable(one)).items())
    assert (one._actions == other._actions).all()
    batch = one.sample(20, 0.5, rng)
    assert (batch.labels == batch.actions).all()
    assert (other.sample(20, 0.5, rng).labels == -1).all()
    # The same transitions without their next frames.
    whole, part = (one.sample(20, 0.5, np.random.default_rng(1), following=following) for following in (True, False))
    assert (whole.slots == part.slots).all()
    assert (whole.frames == part.frames).all()
    assert (len(whole.next_frames), len(part.next_frames)) == (20, 0)


def test_rare_labels_weigh_more_and_the_mean_is_one() -> None:
    replay = Replay(RawFrames(200, SHAPE), 200, 1, GAMMA)
    actions = np.array([0] * 81 + [3] * 9 + [7] * 1)
    replay.add_episode(np.stack([frame(0)] * 92), actions, np.zeros(91), True, actions)
    weights = replay._weights_of_labels()
    assert weights[3] / weights[0] == pytest.approx(3)
    assert weights[7] / weights[0] == pytest.approx(9)
    assert weights[actions].mean() == pytest.approx(1)
    assert weights[-1] == weights[5] == 0


def test_nothing_can_be_drawn_before_its_return_is_known() -> None:
    replay = Replay(RawFrames(100, SHAPE), 100, 3, GAMMA)
    replay.reset(1)
    for step in range(5):
        here, there = frame(step)[None], frame(step + 1)[None]
        no = np.array([False])
        replay.add(np.array([0]), here, np.array([0]), np.array([1.0]), no, no, there)
        assert len(drawable(replay)) == max(step - 2, 0)
    # A step in which every lane is only reset adds nothing.
    none = np.array([], np.int64)
    replay.add(none, here[:0], none, none.astype(float), none.astype(bool), none.astype(bool), here[:0])
    assert replay.added == 5
    batch = replay.sample(8, 0.4, np.random.default_rng(0))
    assert batch.returns == pytest.approx(1 + GAMMA + GAMMA**2)
    assert batch.discounts == pytest.approx(GAMMA**3)
    assert {number(after) - number(before) for before, after in zip(batch.frames, batch.next_frames, strict=True)} == {
        3
    }


def filled(count: int, kept: int = 0) -> Replay:
    """Transitions of one step each, of which some are demonstrations."""
    replay = Replay(RawFrames(count, SHAPE), count, 1, GAMMA)
    for first, end in ((0, kept), (kept, count)):
        if end > first:
            lanes = np.arange(1)
            replay.reset(1)
            for step in range(first, end):
                replay.add(
                    lanes, frame(step)[None], lanes, np.ones(1), np.array([True]), np.array([False]), frame(0)[None]
                )
        if first == 0 and kept:
            replay.protect()
    return replay


def test_errors_decide_how_often_and_weights_make_up_for_it() -> None:
    from scipy import stats

    replay = filled(200)
    rng = np.random.default_rng(0)
    errors = rng.exponential(size=200).astype(np.float32)
    replay.update(np.arange(200), errors)
    chances = (errors.astype(float) + 1e-3) ** 0.6
    chances /= chances.sum()
    counts = np.zeros(200)
    for _ in range(2500):
        batch = replay.sample(16, 1.0, rng)
        np.add.at(counts, batch.slots, 1)
        # With full correction every transition counts the same in the long run.
        weights = (1 / chances[batch.slots]) / (1 / chances[batch.slots]).max()
        assert np.allclose(batch.weights, weights, rtol=1e-4)
    assert stats.chisquare(counts, chances * counts.sum()).pvalue > 0.01


def test_a_share_of_the_batch_can_be_demonstrations() -> None:
    replay = filled(400, 100)
    replay.update(np.arange(100), np.full(100, 0.01, np.float32))
    rng = np.random.default_rng(0)
    batch = replay.sample(32, 0.5, rng, 0.25)
    assert (batch.slots < 100).sum() == 8
    # Within each part all priorities are equal, and the weights do not undo the share, although there are three times
    # as many others.
    assert batch.weights == pytest.approx(np.ones(32), rel=1e-4)
    replay.update(np.arange(40), np.full(40, 0.04, np.float32))
    batch = replay.sample(4000, 1.0, rng, 0.9)
    demonstrations = batch.slots < 100
    assert demonstrations.mean() == pytest.approx(0.9, abs=0.001)
    # The likelier demonstrations count less, so that all demonstrations count the same in the long run.
    counted = np.bincount(batch.slots[demonstrations], batch.weights[demonstrations], 100)
    assert counted[:40].mean() == pytest.approx(counted[40:].mean(), rel=0.1)


def test_a_small_share_is_met_over_many_batches() -> None:
    replay, rng = filled(400, 100), np.random.default_rng(0)
    drawn = np.concatenate([replay.draw(32, 0.5, rng, 0.01)[0] for _ in range(2000)])
    assert (drawn < 100).mean() == pytest.approx(0.01, rel=0.2)


def test_one_large_error_does_not_rank_new_transitions_for_ever() -> None:
    replay = filled(50)
    replay.update(np.array([3]), np.array([1e6], np.float32))
    first = replay.highest
    for _ in range(3000):
        replay.update(np.arange(10, 20), np.ones(10, np.float32))
    assert first > 3000
    assert replay.highest < first / 15
    for _ in range(12_000):
        replay.update(np.arange(10, 20), np.ones(10, np.float32))
    assert replay.highest == pytest.approx(1, rel=0.01)


def test_a_share_waits_for_something_else_than_demonstrations() -> None:
    rng, lanes = np.random.default_rng(0), np.arange(8)
    here, no, none = np.stack([frame(0)] * 8), np.zeros(8, bool), np.zeros(8)
    for _ in range(20):
        count = int(rng.integers(300, 3000))
        replay = Replay(RawFrames(count + 500, SHAPE), count + 500, 3, GAMMA)
        play(replay, rng, 1, count // 2, 1)
        replay.protect()
        # Sums of so many priorities differ by what was rounded.
        replay.update(drawable(replay), rng.random(replay.drawable).astype(np.float32))
        replay.reset(8)
        for settled in (False, False, False, True):
            replay.add(lanes, here, lanes, none, no, no, here)
            slots, _ = replay.draw(32, 0.5, rng, 0.5)
            again = Replay(RawFrames(replay.size, SHAPE), replay.size, 3, GAMMA)
            again.restore(*replay.state())
            for one in (slots, again.draw(32, 0.5, rng, 0.5)[0]):
                assert np.bincount(one).max() < (16 if settled else 8)
                assert (one >= replay.kept).sum() == (16 if settled else 0)


def test_a_ring_that_could_come_round_too_soon_is_refused() -> None:
    with pytest.raises(ValueError, match="too few for 8 environments"):
        Replay(RawFrames(60, SHAPE), 60, 3, GAMMA).reset(8)


def test_advice_belongs_to_its_transition_until_it_is_overwritten() -> None:
    replay = Replay(RawFrames(40, SHAPE), 40, 1, GAMMA, advised=4)
    rng = np.random.default_rng(0)

    def add(steps: int, advised: bool) -> None:
        advice = np.eye(4)[np.arange(steps) % 4] * 0.5 + 0.125 if advised else None
        frames = rng.integers(0, 255, (steps + 1, *SHAPE), dtype=np.uint8)
        replay.add_episode(frames, np.arange(steps), np.zeros(steps), True, np.arange(steps) % 4, advice)

    replay.reset(1)
    add(20, True)
    add(10, False)
    batch = replay.sample(200, 0.0, rng)
    known = batch.slots < 20
    assert 0 < known.sum() < 200
    assert (batch.advice[known].argmax(1) == batch.labels[known]).all()
    assert batch.advice[known].sum(1) == pytest.approx(1)
    assert not batch.advice[~known].any()
    again = Replay(RawFrames(40, SHAPE), 40, 1, GAMMA, advised=4)
    again.load(0, replay.dump(0, len(replay)))
    again.restore(*replay.state())
    assert (again.sample(200, 0.0, np.random.default_rng(1)).advice[:, 0] > 0).any()
    # The ring comes round.
    add(25, False)
    batch = replay.sample(200, 0.0, rng)
    assert not batch.advice[batch.slots < 15].any()


def test_decisiveness_is_between_no_matter_and_one_good_action() -> None:
    advice = np.array([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [0.25] * 4, [0.9, 0.05, 0.05, 0], [0.5, 0.3, 0.2, 0]])
    found = decisiveness(advice)
    assert found[:3] == pytest.approx([1, 0, 0])
    assert 0 < found[4] < found[3] < 1


def test_states_with_decisive_advice_are_sampled_more_often_and_errors_change_nothing() -> None:
    from scipy import stats

    rng = np.random.default_rng(0)
    replay = Replay(RawFrames(40, SHAPE), 40, 1, GAMMA, alpha=1.0, advised=3)
    replay.reset(0)
    sharp, flat = [0.9, 0.05, 0.05], [0.6, 0.2, 0.2]
    advice = np.array([sharp, flat] * 5)
    frames = np.stack([frame(number) for number in range(11)])
    replay.add_episode(frames, np.zeros(10, np.int64), np.zeros(10), True, np.zeros(10, np.int64), advice)
    # A small constant is added to every priority.
    priorities = decisiveness(advice) + 1e-3
    share = priorities[::2].sum() / priorities.sum()
    for _ in range(2):
        batch = replay.sample(20_000, 1.0, rng)
        sharp_ones = np.count_nonzero(batch.slots % 2 == 0)
        assert stats.binomtest(int(sharp_ones), 20_000, share).pvalue > 1e-4
        assert (batch.weights == 1).all()
        replay.update(batch.slots, np.where(batch.slots % 2, 100.0, 0.0).astype(np.float32))


def test_a_replay_is_put_back_as_it_was() -> None:
    rng = np.random.default_rng(5)
    replay = Replay(RawFrames(90, SHAPE), 90, 2, GAMMA)
    _, first = play(replay, rng, 1, 20, 1)
    replay.protect()
    play(replay, rng, 3, 60, first)
    replay.update(drawable(replay), rng.random(len(drawable(replay))).astype(np.float32))
    numbers, arrays = replay.state()
    again = Replay(RawFrames(90, SHAPE), 90, 2, GAMMA)
    for begin in range(0, len(replay), 40):
        again.load(begin, replay.dump(begin, min(begin + 40, len(replay))))
    again.restore(numbers, arrays)
    one, other = (each.sample(32, 0.5, np.random.default_rng(0)) for each in (replay, again))
    for field_name in (
        "slots",
        "frames",
        "next_frames",
        "actions",
        "returns",
        "discounts",
        "weights",
        "labels",
        "label_weights",
        "advice",
    ):
        assert (getattr(one, field_name) == getattr(other, field_name)).all(), field_name
    play(replay, np.random.default_rng(6), 2, 5, 1000)
    play(again, np.random.default_rng(6), 2, 5, 1000)
    assert held(replay, drawable(replay)) == held(again, drawable(again))
