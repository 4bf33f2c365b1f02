"""Transfer to families that the training left out."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner
from envcraft_dqn.study.presets import TRANSFER
from envcraft_dqn.study.protocol import PRIVILEGED, RANDOM, Task, training_settings
from envcraft_dqn.study.report import transfer_section, write_transfer
from envcraft_dqn.study.selection import StudyEnv
from envcraft_dqn.study.transfer import SCRATCH, TUNED, ZERO_SHOT, TransferSummary, summarise_transfer, transfer_tasks
from envcraft_dqn.study.worker import TaskResult

from envcraft.cli.group import cli
from envcraft.errors import UsageError

from .test_study_summary import result

PROTOCOL = msgspec.structs.replace(TRANSFER["smoke"], folds=3)
ENVIRONMENTS = [StudyEnv(f"{family}{at}", f"{family}{at}", family) for family in ("maze", "snake") for at in range(6)]


def test_no_environment_of_the_family_is_seen_before_and_none_of_the_tests_ever() -> None:
    found = {task.name: task for task in transfer_tasks(PROTOCOL, ENVIRONMENTS, (100, 400))}
    for family, other in (("maze", "snake"), ("snake", "maze")):
        own = [task for name, task in found.items() if name.startswith(f"{family}.")]
        tests = {task.environments for task in own if task.kind == "play"}
        assert len(tests) == 1
        [test] = tests
        assert len(test) == 2
        assert {name[:-1] for name in test} == {family}
        for task in own:
            if task.kind == "train":
                assert not set(test) & set(task.environments)
                source = task.condition == "source"
                assert {name[:-1] for name in task.environments} == {other if source else family}
                settings = training_settings(PROTOCOL, task)
                assert settings.steps == (PROTOCOL.settings.steps if source else task.steps)
                # Further training learns from steps in the family alone.
                assert bool(settings.pretrain_updates) == source == task.demonstrations
                assert bool(task.initial) == task.condition.startswith(TUNED)
            assert set(task.after) <= found.keys()
    names = list(found)
    assert all(names.index(after) < names.index(task.name) for task in found.values() for after in task.after)


def test_results_by_family_include_those_without_effect(tmp_path: Path) -> None:
    def played(split: int, condition: str, totals: dict[str, float]) -> TaskResult:
        return result(condition, split, totals)

    found = [
        played(0, RANDOM, {"a": 0.0, "b": 10.0}),
        played(0, PRIVILEGED, {"a": 100.0, "b": 110.0}),
        played(0, ZERO_SHOT, {"a": 10.0, "b": 40.0}),
        played(0, f"{TUNED} 100", {"a": 50.0, "b": 60.0}),
        played(0, f"{SCRATCH} 100", {"a": 0.0, "b": 10.0}),
        # No scale: the privileged player is no better than chance.
        played(1, RANDOM, {"c": 5.0}),
        played(1, PRIVILEGED, {"c": 5.0}),
        played(1, ZERO_SHOT, {"c": 9.0}),
    ]
    summary = summarise_transfer(PROTOCOL, "search", {one.task.name: one for one in found}, ENVIRONMENTS)
    maze, snake = summary.families
    assert maze.zero_shot is not None
    assert maze.zero_shot.mean == pytest.approx(20)
    assert (maze.environments, maze.tuned_half, maze.scratch_half) == (2, 100, None)
    assert (snake.family, snake.environments, snake.zero_shot) == ("snake", 0, None)
    report = write_transfer(tmp_path, summary).read_text()
    assert "| maze | from random weights | +0.0 \\[0.0, 0.0\\] | not reached |" in report
    assert "| snake | 0 | no scale |" in report
    assert msgspec.json.decode((tmp_path / "summary.json").read_bytes(), type=TransferSummary) == summary
    assert "Each of the 2 families has" in report
    row = "| maze | after the other families | +50.0 \\[50.0, 50.0\\] | 100 |"
    assert row in report
    section = transfer_section(summary)
    assert row in section
    assert "### Further training in the family" in section


def test_one_family_is_too_few(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="two families or more, and these are of maze"):
        transfer_tasks(PROTOCOL, ENVIRONMENTS[:6], (100,))
    done = CliRunner().invoke(
        cli, ["study", "transfer", "--scale", "smoke", "--family", "tetris", "--output", str(tmp_path / "out")]
    )
    assert done.exit_code == 2
    assert "a transfer needs two families or more, not tetris" in done.output
    assert not (tmp_path / "out").exists()


def test_tuned_agents_start_from_the_source() -> None:
    tasks = transfer_tasks(PROTOCOL, ENVIRONMENTS, (100,))
    tuned: list[Task] = [task for task in tasks if task.condition == f"{TUNED} 100" and task.kind == "train"]
    assert [task.initial for task in tuned] == [
        "runs/maze.train.source/agent.safetensors",
        "runs/snake.train.source/agent.safetensors",
    ]
