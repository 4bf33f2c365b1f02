"""Summaries of study results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.study import privileged
from envcraft_dqn.study.metric import Interval, Score, bootstrap
from envcraft_dqn.study.presets import PRESETS
from envcraft_dqn.study.protocol import AGENT, FAMILIAR, RANDOM, UNTRAINED, Task, tasks
from envcraft_dqn.study.report import headline, section, write
from envcraft_dqn.study.selection import EnvFactory
from envcraft_dqn.study.summary import Summary, summarise
from envcraft_dqn.study.worker import TaskRequest, TaskResult, untrained_agent

from envcraft.corpus.store.demonstrations import EpisodeOutcome
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


@pytest.mark.parametrize(("successes", "rate"), [((True, None, None), None), ((True, False, None), 0.5)])
def test_score_of_a_player_can_be_stored(successes: tuple[bool | None, ...], rate: float | None) -> None:
    score = privileged._score("lamp", [EpisodeOutcome(10 + at, 1.0, one) for at, one in enumerate(successes)])
    stored = msgspec.json.decode(msgspec.json.encode(score), type=Score)
    assert stored == score
    assert (stored.wins and stored.wins.mean) == rate


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
    assert "\\[-inf, inf\\]" in report
    assert "so the gate is closed" in report


def test_gate_needs_a_lead_over_every_control_in_training_environments(tmp_path: Path) -> None:
    def played(condition: str, totals: list[float]) -> list[TaskResult]:
        return [result(condition, split, {f"{split}{at}": one for at, one in enumerate(totals)}) for split in (0, 1)]

    scale = played("familiar random", [0.0, 1.0, 2.0]) + played("familiar privileged", [40.0, 41.0, 42.0])
    agent = played(FAMILIAR, [20.0, 22.0, 21.0]) + played(AGENT, [20.0, 22.0, 21.0])
    weak = played("familiar noop", [3.0, 3.0, 4.0]) + played("familiar coin flip", [5.0, 3.0, 4.0])
    protocol = PRESETS["smoke"]
    passed = summarise(protocol, {one.task.name: one for one in scale + agent + weak}, {}).competence
    assert passed.passed
    assert [row.condition for row in passed.training] == ["agent", "random", "noop", "coin flip", "privileged"]
    assert passed.training[0].means["return"].mean == pytest.approx(50)
    # One control that is as good in one of the environments, and better in the others.
    strong = played("familiar constant", [20.0, 23.0, 23.0])
    stopped = summarise(protocol, {one.task.name: one for one in scale + agent + weak + strong}, {}).competence
    assert not stopped.passed
    assert stopped.unbeaten == ["constant"]
    # What documentation states comes from the stored summary alone.
    held_out = played(RANDOM, [0.0, 1.0, 2.0]) + played("privileged", [40.0, 41.0, 42.0])
    trained = [TaskResult(Task("train", "train", AGENT, 0, ("0",)), 1.0, 1.0, updates=1234, steps=5678)]
    found = {one.task.name: one for one in scale + agent + weak + strong + held_out + trained}
    stored = write(tmp_path, protocol, "search", found, summarise(protocol, found, {})).with_name("summary.json")
    text = section(msgspec.json.decode(stored.read_bytes(), type=Summary))
    assert "The gate is not passed" in text
    assert "the constant action that is best in training environments." in text
    assert "| coin flip: random moves without buttons | 6 | 7.5 \\[" in text
    assert "1,234 updates of 16 transitions and 5,678 online steps" in text
    # No return is stated of an agent that has not learned to play.
    assert headline(msgspec.json.decode(stored.read_bytes(), type=Summary)) == (
        "An agent trained on 1 environments and played 6 that it had not seen. It does not beat every control in the "
        "environments of its own training.\n"
    )
    learned = {name: one for name, one in found.items() if "constant" not in name}
    stated = headline(summarise(protocol, learned, {}))
    assert "Its return is 50.0 [" in stated
    assert "lines or groups" not in stated
    # Without tests in training environments the gate stays closed.
    assert not summarise(protocol, {}, {}).competence.passed


def test_scaling_curve_has_the_gap_by_size() -> None:
    def trained(condition: str, count: int) -> TaskResult:
        task = Task(f"train {condition}", "train", condition, 0, tuple(map(str, range(count))))
        return TaskResult(task, 1.0, 1.0)

    found = [
        result("familiar random", 0, {"t": 0.0, "u": 0.0}),
        result("familiar privileged", 0, {"t": 100.0, "u": 100.0}),
        result(RANDOM, 0, {"h": 0.0, "i": 0.0}),
        result("privileged", 0, {"h": 100.0, "i": 100.0}),
        trained(AGENT, 50),
        result(AGENT, 0, {"h": 40.0, "i": 50.0}),
        result(FAMILIAR, 0, {"t": 50.0, "u": 60.0}),
        trained("subset 2", 2),
        result("subset 2", 0, {"h": 10.0, "i": 10.0}),
        result("familiar subset 2", 0, {"t": 80.0, "u": 80.0}),
    ]
    sizes = summarise(PRESETS["smoke"], {one.task.name: one for one in found}, {}).competence.sizes
    assert [one.environments for one in sizes] == [2, 50]
    assert [one.gap.mean for one in sizes] == pytest.approx([70, 10])
    assert sizes[0].gap == Interval(70.0, 70.0, 70.0)


def test_bootstrap_resamples_agents_and_their_environments() -> None:
    rng = np.random.default_rng(1)
    # The means of agents differ much more than environments within an agent.
    values: dict[Any, list[float]] = {agent: (10 * agent + rng.normal(size=50)).tolist() for agent in range(4)}
    interval = bootstrap(values)
    assert interval.mean == pytest.approx(15, abs=0.5)
    # The standard error over four agents is 10 sqrt(1.25) / 2 = 5.6; that of 200 independent environments would be 0.8.
    assert 8 < (interval.high - interval.low) / 2 < 12
    assert bootstrap({0: [3.0]}) == Interval(3.0, 3.0, 3.0)
