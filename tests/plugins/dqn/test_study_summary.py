"""Summaries of study results."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.study.metric import Score
from envcraft_dqn.study.presets import PRESETS
from envcraft_dqn.study.protocol import AGENT, FAMILIAR, RANDOM, UNTRAINED, Task, tasks
from envcraft_dqn.study.report import write
from envcraft_dqn.study.selection import EnvFactory
from envcraft_dqn.study.summary import summarise
from envcraft_dqn.study.worker import TaskRequest, TaskResult, untrained_agent

from envcraft.judging.statistics import Mean


def test_each_split_has_its_own_untrained_network(tmp_path: Path) -> None:
    protocol = msgspec.structs.replace(PRESETS["smoke"], folds=3)
    found = [task for task in tasks(protocol, ["a", "b", "c"]) if task.player == UNTRAINED]
    files = set()
    for task in found:
        request = TaskRequest(protocol, EnvFactory("", True), str(tmp_path), task, "", [], "cpu", "process")
        files.add(untrained_agent(request, EnvSpec((16, 16, 3), (5, 2, 2))).read_bytes())
    assert len(files) == 3


def result(condition: str, split: int, lengths: dict[str, float]) -> TaskResult:
    scores = [
        Score(name, 2, Mean(mean, 1.0, mean, mean), Mean(mean, 1.0, mean, mean)) for name, mean in lengths.items()
    ]
    task = Task(f"{condition} {split}", "play", condition, split, tuple(lengths))
    return TaskResult(task, 1.0, 1.0, scores)


def test_gap_pairs_environments() -> None:
    found = [
        result(RANDOM, 0, {"easy": 10.0, "hard": 10.0, "other": 10.0}),
        result(AGENT, 0, {"easy": 30.0}),
        result(AGENT, 1, {"hard": 10.0}),
        result(AGENT, 2, {"other": 90.0}),
        # The paired gaps are 10 and 20% of random play in one environment and 10% in the other; plain means contradict.
        result(FAMILIAR, 1, {"easy": 31.0}),
        result(FAMILIAR, 2, {"easy": 32.0, "hard": 11.0}),
    ]
    protocol = msgspec.structs.replace(PRESETS["smoke"], metric="length")
    summary = summarise(protocol, {one.task.name: one for one in found}, {})
    assert summary.gap is not None
    assert summary.gap.mean == pytest.approx((15 + 10) / 2)
    # With one degree of freedom, the quantile of Student's t is 12.706.
    assert (summary.gap.low, summary.gap.high) == pytest.approx((12.5 - 12.706 * 2.5, 12.5 + 12.706 * 2.5), rel=1e-4)
    assert summarise(protocol, {one.task.name: one for one in found[:4]}, {}).gap is None


@pytest.mark.filterwarnings("error")
def test_single_environment_has_an_infinite_interval(tmp_path: Path) -> None:
    found = [result(RANDOM, 0, {"easy": 10.0}), result(AGENT, 0, {"easy": 30.0}), result(UNTRAINED, 0, {"easy": 5.0})]
    protocol = msgspec.structs.replace(PRESETS["smoke"], metric="length")
    found.append(TaskResult(Task("train", "train", AGENT, 0, ("hard",)), 1.0, 1.0, []))
    results = {one.task.name: one for one in found}
    report = write(tmp_path, protocol, "search", results, summarise(protocol, results, {"easy": ""})).read_text()
    assert "\\[-inf, inf\\], on both sides of zero: the difference from chance is not significant" in report
