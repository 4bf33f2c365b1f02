"""The folds of a study: no agent is tested on its training environments, and every environment is tested once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from envcraft_dqn.study.folds import sample, splits, subset
from envcraft_dqn.study.presets import PRESETS
from envcraft_dqn.study.protocol import tasks
from envcraft_dqn.study.selection import select
from hypothesis import given
from hypothesis import strategies as st

from envcraft.corpus.store import Store
from envcraft.errors import UsageError


def names_of(count: int) -> list[str]:
    return [f"tetris_0_{number:04}.py" for number in range(count)]


@given(st.integers(2, 60).flatmap(lambda count: st.tuples(st.just(count), st.integers(2, count))), st.integers(0, 9))
def test_each_environment_is_held_out_once(count_and_folds: tuple[int, int], seed: int) -> None:
    count, folds = count_and_folds
    names = names_of(count)
    found = splits(names, folds, seed)
    assert [split.number for split in found] == list(range(folds))
    assert Counter(name for split in found for name in split.test) == Counter(names)
    for split in found:
        assert not set(split.train) & set(split.test)
        assert sorted(split.train + split.test) == names
        assert count // folds <= len(split.test) <= -(-count // folds)
    # Neither the order in which they come, nor anything but the seed, matters.
    assert splits(names[::-1], folds, seed) == found


@given(st.integers(4, 40), st.integers(0, 9), st.data())
def test_smaller_subsets_are_part_of_larger_ones(count: int, seed: int, data: st.DataObject) -> None:
    split = splits(names_of(count), 2, seed)[1]
    sizes = sorted(data.draw(st.lists(st.integers(1, len(split.train)), min_size=2, max_size=3)))
    found = [set(subset(split, size, seed)) for size in sizes]
    assert [len(one) for one in found] == sizes
    for one, larger in zip(found, [*found[1:], set(split.train)], strict=True):
        assert one <= larger
    assert set(sample(split, 3, seed)) <= set(split.train)


def test_thousand_in_ten_folds_are_nine_hundred_and_a_hundred() -> None:
    found = splits(names_of(1000), 10, 0)
    assert {(len(split.train), len(split.test)) for split in found} == {(900, 100)}
    assert found != splits(names_of(1000), 10, 1)


def test_impossible_splits_are_usage_errors() -> None:
    with pytest.raises(UsageError, match="3 environments cannot be split into 4 folds"):
        splits(names_of(3), 4, 0)
    with pytest.raises(UsageError, match="1 folds"):
        splits(names_of(3), 1, 0)
    with pytest.raises(UsageError, match="twice"):
        splits(["a", "a", "b"], 2, 0)
    with pytest.raises(UsageError, match="a subset of 4 is not possible: a split trains on 3"):
        subset(splits(names_of(6), 2, 0)[0], 4, 0)


def test_copies_are_chosen_among_those_that_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Store.create(tmp_path / "corpus") as store:
        for name, source in (
            ("a.py", b"speed = 3\nprint(speed)\n"),
            ("b.py", b"speed = 3\nprint(speed)\n"),
            # Other layout, another name, and last another game.
            ("c.py", b"# mine\nspeed = 3\n\nprint( speed )\n"),
            ("d.py", b"fast = 3\nprint(fast)\n"),
            ("e.py", b"speed = 4\nprint(speed)\n"),
        ):
            store.add(name, source)
    assert [one.name for one in select(tmp_path / "corpus", ())] == ["a.py", "e.py"]
    assert "skipped 3 of 5 environments, because they are copies of others" in capsys.readouterr().err
    for other in "bcd":
        assert [one.name for one in select(tmp_path / "corpus", [f"[{other}e].py"])] == [f"{other}.py", "e.py"]


def test_tasks_of_the_reference() -> None:
    protocol = PRESETS["reference"]
    assert (protocol.recorded, protocol.settings.demonstrations, protocol.episodes) == (10_000, 1_000, 1_000)
    found = tasks(protocol, names_of(1000))
    seeds = {task.split: task.seed for task in found if task.condition == "agent" and task.kind == "train"}
    assert len(set(seeds.values())) == 10
    # The agents of a split start with equal weights, so that only their environments differ.
    assert all(task.seed == seeds[task.split] for task in found if task.kind == "train" and "subset" in task.condition)
    assert len({task.name for task in found}) == len(found)
    trained = Counter(task.condition for task in found if task.kind == "train")
    assert trained == {
        "agent": 10,
        "without demonstrations": 2,
        "seed 2": 2,
        "subset 700": 5,
        "subset 500": 5,
        "subset 300": 1,
        "subset 100": 1,
    }
    parts = splits(names_of(1000), 10, protocol.seed)
    known = {task.name for task in found}
    for task in found:
        assert set(task.after) <= known
        part = parts[task.split]
        trains = task.kind == "train" or task.condition.startswith("familiar")
        assert set(task.training) <= set(part.train)
        assert set(task.environments) <= set(part.train if trains else part.test)
        if not trains:
            assert task.environments == part.test
    assert sum(len(task.environments) for task in found if task.condition == "random") == 1000
