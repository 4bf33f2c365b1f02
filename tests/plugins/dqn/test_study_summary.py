"""What a study's results come to."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from envcraft_dqn.spaces import Surface
from envcraft_dqn.study.metric import Score
from envcraft_dqn.study.places import Place
from envcraft_dqn.study.protocol import AGENT, FAMILIAR, RANDOM, UNTRAINED, Task, tasks
from envcraft_dqn.study.report import write
from envcraft_dqn.study.scales import SCALES
from envcraft_dqn.study.summary import summarise
from envcraft_dqn.study.work import Order, Result, _untrained

from envcraft.stats import Mean


def test_each_split_has_an_untrained_network_of_its_own(tmp_path: Path) -> None:
    protocol = msgspec.structs.replace(SCALES["smoke"], folds=3)
    found = [task for task in tasks(protocol, ["a", "b", "c"]) if task.player == UNTRAINED]
    files = set()
    for task in found:
        order = Order(protocol, Place("", True), str(tmp_path), task, "", [], "cpu", "process")
        files.add(_untrained(order, Surface((16, 16, 3), (5, 2, 2))).read_bytes())
    assert len(files) == 3


def result(condition: str, split: int, lengths: dict[str, float]) -> Result:
    scores = [
        Score(name, 2, Mean(mean, 1.0, mean, mean), Mean(mean, 1.0, mean, mean)) for name, mean in lengths.items()
    ]
    task = Task(f"{condition} {split}", "play", condition, split, tuple(lengths))
    return Result(task, 1.0, 1.0, scores)


def test_what_was_trained_on_is_held_against_the_same_environments() -> None:
    found = [
        result(RANDOM, 0, {"easy": 10.0, "hard": 10.0, "other": 10.0}),
        result(AGENT, 0, {"easy": 30.0}),
        result(AGENT, 1, {"hard": 10.0}),
        result(AGENT, 2, {"other": 90.0}),
        # Longer by 10 and 20 percent of random play in the one, by 10 in the other; the means alone say the contrary.
        result(FAMILIAR, 1, {"easy": 31.0}),
        result(FAMILIAR, 2, {"easy": 32.0, "hard": 11.0}),
    ]
    protocol = msgspec.structs.replace(SCALES["smoke"], metric="length")
    summary = summarise(protocol, {one.task.name: one for one in found}, {})
    assert summary.gap is not None
    assert summary.gap.mean == pytest.approx((15 + 10) / 2)
    # Of two environments the interval is wide: Student's t with one degree of freedom is 12.706.
    assert (summary.gap.low, summary.gap.high) == pytest.approx((12.5 - 12.706 * 2.5, 12.5 + 12.706 * 2.5), rel=1e-4)
    assert summarise(protocol, {one.task.name: one for one in found[:4]}, {}).gap is None


@pytest.mark.filterwarnings("error")
def test_a_single_environment_tells_nothing_and_is_drawn(tmp_path: Path) -> None:
    found = [result(RANDOM, 0, {"easy": 10.0}), result(AGENT, 0, {"easy": 30.0}), result(UNTRAINED, 0, {"easy": 5.0})]
    protocol = msgspec.structs.replace(SCALES["smoke"], metric="length")
    found.append(Result(Task("train", "train", AGENT, 0, ("hard",)), 1.0, 1.0, []))
    results = {one.task.name: one for one in found}
    report = write(tmp_path, protocol, "search", results, summarise(protocol, results, {"easy": ""})).read_text()
    assert "\\[-inf, inf\\], on both sides of zero: this does not tell it from chance" in report
