"""``envcraft train`` and ``envcraft evaluate``, from the command line to the files."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from envcraft.cli.group import cli
from envcraft.corpus.store import Store
from envcraft.files import UNFINISHED

from .conftest import GAMES

_OPTIONS = "--size tiny --steps 300 --lanes 4 --leg 20 --capacity 2000 --starts 50 --device cpu --trust --workers 0"
DEMOS = ("--demos", "random", "--pretrain-updates", "20", "--demonstrations", "200")
TRAIN = (*_OPTIONS.split(" "), "--checkpoint-minutes", "0")


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    with Store.create(tmp_path / "corpus") as store:
        for path in sorted(GAMES.glob("*.py")):
            store.add(path.name, path.read_bytes())
    return tmp_path / "corpus"


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def test_train_then_evaluate(corpus: Path, tmp_path: Path) -> None:
    output = tmp_path / "run"
    result = run("train", corpus, "--output", output, *TRAIN, *DEMOS)
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(output / "agent.safetensors")
    assert list((output / "tensorboard").glob("events.*"))
    numbers = json.loads((output / "checkpoint" / "state.json").read_text())["numbers"]
    assert numbers["updates"] == 20 + numbers["steps"] // 4
    # A completed run is not repeated.
    assert run("train", corpus, "--output", output, *TRAIN, *DEMOS).exit_code == 0
    told = tmp_path / "told.json"
    where = (corpus, "--trust", "--workers", "0", "--episodes", "20", "--device", "cpu", "--output", told)
    result = run("evaluate", *where, "--player", f"checkpoint:{output}", "--epsilon", "0.1")
    assert result.exit_code == 0, result.output
    found = json.loads(told.read_text())
    assert json.loads(result.stdout) == found
    assert [one["name"] for one in found["environments"]] == ["catch.py", "lamps.py"]
    for one in found["environments"]:
        assert one["length"]["mean"] == {"catch.py": 6.0, "lamps.py": 8.0}[one["name"]]
        assert one["return"]["low"] < one["return"]["mean"] < one["return"]["high"]


def test_run_with_held_out_environments_and_its_configuration(corpus: Path, tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    one, again = tmp_path / "one", tmp_path / "again"
    testing = ("--eval-every", "20", "--held-out", "lamps*", "--eval-episodes", "2", "--alpha", "0.5")
    assert run("train", corpus, "--output", one, *TRAIN, *testing).exit_code == 0
    state = json.loads((one / "checkpoint" / "state.json").read_text())
    assert state["environments"] == ["catch.py"]
    assert state["settings"]["alpha"] == 0.5
    scores = json.loads((one / "held-out.json").read_text())
    assert [int(updates) % 20 for updates in scores] == [0] * (state["numbers"]["updates"] // 20)
    assert (one / "best.safetensors").is_file()
    events = EventAccumulator(str(one / "tensorboard"))
    events.Reload()
    tags = events.Tags()
    assert {"return/catch.py", "values/gap", "held out/score"} <= set(tags["scalars"])
    assert tags["histograms"] == ["actions"]
    # The file of options gives the same run, and options come before it.
    config = ("--config", one / "config.toml")
    assert run("train", corpus, "--output", again, *config).exit_code == 0
    assert (again / "agent.safetensors").read_bytes() == (one / "agent.safetensors").read_bytes()
    more = run("train", corpus, "--output", again, *config, "--alpha", "0.6")
    assert more.exit_code == 2
    assert "alpha 0.5, not 0.6" in " ".join(more.output.split())
    odd = tmp_path / "odd.toml"
    odd.write_text("speed = 3\n")
    refused = run("train", corpus, "--output", again, "--config", odd)
    assert refused.exit_code == 2
    assert "the key 'speed', which is not an option of" in " ".join(refused.output.split())
    picture = tmp_path / "play.gif"
    playing = ("--player", f"checkpoint:{one}", "--trust", "--workers", "0", "--episodes", "2", "--device", "cpu")
    assert run("evaluate", corpus, *playing, "--gif", picture).exit_code == 0
    # An episode of catch.py has six steps.
    assert picture.read_bytes().startswith(b"GIF89a")
    from PIL import Image, ImageSequence

    with Image.open(picture) as opened:
        assert sum(1 for _ in ImageSequence.Iterator(opened)) == 7
        assert opened.size == (84, 84)


def test_refused_run_leaves_no_curves(corpus: Path, tmp_path: Path) -> None:
    refused = run("train", corpus, "--output", tmp_path / "run", *TRAIN, "--pretrain-updates", "20")
    assert refused.exit_code == 2
    assert "need demonstrations" in refused.output
    assert not (tmp_path / "run" / "tensorboard").exists()


def test_a_folder_of_something_else_is_refused(corpus: Path, tmp_path: Path) -> None:
    report = tmp_path / "report"
    report.mkdir()
    (report / "index.html").write_text("<html>")
    refused = run("train", corpus, "--output", report, *TRAIN)
    assert refused.exit_code == 2
    assert f"{report} contains index.html and is not a run; name a folder that is new, empty or a run" in refused.output
    assert [entry.name for entry in report.iterdir()] == ["index.html"]


def test_a_run_that_ended_before_its_first_file_does_not_refuse_the_next(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full, killed, stopped = (tmp_path / name for name in ("full", "killed", "stopped"))

    def no_space(source: str | Path, target: str | Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", no_space)
        assert run("train", corpus, "--output", full, *TRAIN).exit_code == 3
    assert list(full.iterdir()) == []
    killed.mkdir()
    (killed / f"{UNFINISHED}0123").write_text("[envcraft]")
    with monkeypatch.context() as patched:
        patched.setattr("envcraft_dqn.demo_sources.source_named", _interrupted)
        assert run("train", corpus, "--output", stopped, *TRAIN, "--demos", "noop").exit_code == 130
    (stopped / "demonstrations").mkdir()
    for folder in (killed, stopped):
        refused = run("train", corpus, "--output", folder, *TRAIN, "--pretrain-updates", "20")
        assert "need demonstrations" in refused.output


def _interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_interrupted_run_reports_where_it_resumes(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("envcraft_dqn.callbacks.ProgressLogger.on_progress", interrupt)
    assert "starts over" in run("train", corpus, "--output", tmp_path / "run", *TRAIN).output
    # The first checkpoint follows the demonstrations.
    again = run("train", corpus, "--output", tmp_path / "other", *TRAIN, *DEMOS)
    assert "from the last checkpoint" in again.output


def test_returns_of_simple_policies(corpus: Path) -> None:
    where = (corpus, "--trust", "--workers", "0", "--select", "lamps*")
    means = {}
    for player in ("random", "noop"):
        result = run("evaluate", *where, "--player", player, "--episodes", "300")
        assert result.exit_code == 0, result.output
        [one] = json.loads(result.stdout)["environments"]
        assert one["episodes"] == 300
        means[player] = one["return"]
    for given in means.values():
        # One of four choices is right, in eight steps.
        assert abs(given["mean"] - 2) < 4 * given["standard_error"]
        assert given["standard_error"] == pytest.approx((8 * 3 / 16 / 300) ** 0.5, rel=0.2)
    assert run("evaluate", GAMES / "catch.py", "--trust", "--player", "noop", "--episodes", "2").exit_code == 0


def test_unjudged_code_does_not_run(corpus: Path, tmp_path: Path) -> None:
    marks = tmp_path / "imported"
    shutil.copy(GAMES / "catch.py", tmp_path / "mark.py")
    (tmp_path / "mark.py").write_text(f"open({str(marks)!r}, 'w')\n" + (GAMES / "catch.py").read_text())
    for target in (corpus, tmp_path / "mark.py"):
        result = run("evaluate", target, "--player", "random", "--episodes", "2")
        assert result.exit_code == 2
        assert "has no verdict" in result.output
        assert "judges it" in result.output
    result = run("train", tmp_path / "mark.py", "--output", tmp_path / "run", "--steps", "100")
    assert result.exit_code == 2
    assert "--sandbox auto" in result.output
    assert not (tmp_path / "run").exists()
    assert not marks.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--select", "tetris*"), "has no environment that matches tetris*"),
        (("--demos", "somebody"), "there is no player 'somebody'; choose from random, noop, checkpoint:PATH"),
        (("--demos", "randm"), "there is no player 'randm'; did you mean random?"),
        (("--demos", "chekpoint:run"), "there is no player 'chekpoint:run'; did you mean checkpoint:PATH?"),
        (("--demos", "checkpoint:nowhere"), "nowhere does not exist; name what `envcraft train` wrote"),
        (("--pretrain-updates", "5"), "5 updates of pretraining need demonstrations"),
        (("--demonstration-share", "0.5"), "name their player by --demos"),
        (("--gamma", "1.5"), "gamma is 1.5; it must be between 0 and 1"),
        (("--epsilon-first", "2"), "epsilon_first is 2.0; it must be between 0 and 1"),
        (("--learning-rate", "0"), "learning_rate is 0.0; it must be positive"),
        (("--capacity", "20"), "a replay of 20 slots is too small for 4 environments"),
    ],
)
def test_usage_errors(corpus: Path, tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    result = run("train", corpus, "--output", tmp_path / "run", *TRAIN, *arguments)
    assert result.exit_code == 2, result.output
    assert words in result.output


def test_run_resumes_only_with_the_same_inputs(corpus: Path, tmp_path: Path) -> None:
    output = tmp_path / "run"
    train: tuple[str | Path, ...] = ("train", corpus, "--output", output, *TRAIN)
    assert run(*train, *DEMOS).exit_code == 0
    other = run(*train, "--demos", "noop", *DEMOS[2:])
    assert other.exit_code == 2
    assert "a run with other demonstrations (random, not noop); choose another --output" in other.output
    adapted = run(*train, *DEMOS, "--contract", "arcade-native")
    assert adapted.exit_code == 2
    assert "under arcade-native" in adapted.output
    with Store(corpus, write=True) as store:
        store.remove("catch.py")
        store.add("catch.py", (GAMES / "catch.py").read_bytes() + b"\n# another\n")
    changed = run(*train, *DEMOS)
    assert changed.exit_code == 2
    assert "a run with other sources (catch.py " in changed.output
    state = output / "checkpoint" / "state.json"
    told = json.loads(state.read_text())
    del told["sources"], told["demonstrations"]
    state.write_text(json.dumps(told))
    old = run(*train, *DEMOS)
    assert old.exit_code == 2
    assert "a run of an earlier version of EnvCraft" in old.output


def test_a_run_takes_its_steps_and_can_be_extended(corpus: Path, tmp_path: Path) -> None:
    def steps_of(count: int, output: Path) -> int:
        # The last of two --steps counts. A turn and a leg are far longer than the run.
        options = (*TRAIN, "--leg", "1000", "--steps", str(count), "--select", "catch")
        result = run("train", corpus, "--output", output, *options)
        assert result.exit_code == 0, result.output
        return int(json.loads((output / "checkpoint" / "state.json").read_text())["numbers"]["steps"])

    output = tmp_path / "run"
    taken = steps_of(60, output)
    assert 60 <= taken < 60 + 4
    shorter = run("train", corpus, "--output", output, *TRAIN, "--leg", "1000", "--steps", "40", "--select", "catch")
    assert shorter.exit_code == 2
    assert "a run with other settings (steps 60, not 40)" in shorter.output
    assert steps_of(60, output) == taken
    assert 120 <= steps_of(120, output) < 120 + 4


@pytest.mark.parametrize("pattern", ["catch", "catch.py", "cat*"])
def test_names_are_selected_as_make_takes_them(corpus: Path, pattern: str) -> None:
    from envcraft_dqn.selection import select_environments

    assert select_environments(corpus, [pattern], trust=True).names == ["catch.py"]


def test_folder_allows_one_run(corpus: Path, tmp_path: Path) -> None:
    output = tmp_path / "run"
    output.mkdir()
    (output / "config.toml").touch()
    holding = "import sys; from pathlib import Path; from envcraft_dqn.files import exclusive\n"
    holding += "with exclusive(Path(sys.argv[1])): print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", holding, str(output)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        result = run("train", corpus, "--output", output, *TRAIN)
        assert result.exit_code == 2, result.output
        assert f"process {holder.pid} is running in {output}: wait until it ends" in result.output
        holder.kill()
    assert not (output / "checkpoint").exists()
    assert run("train", corpus, "--output", output, *TRAIN).exit_code == 0


def test_unwritable_output_is_reported_first(corpus: Path, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("kept")
    train = run("train", corpus, "--output", file / "run", *TRAIN)
    evaluate = run("evaluate", corpus, "--player", "random", "--output", file / "told.json", "--trust")
    for result in (train, evaluate):
        assert result.exit_code == 2, result.output
        assert f"{file} is a file; name a folder" in result.output
    assert file.read_text() == "kept"


def test_help_imports_no_torch() -> None:
    code = (
        "import sys; from click.testing import CliRunner; from envcraft.cli.group import cli; "
        "assert CliRunner().invoke(cli, ['train', '--help']).exit_code == 0; "
        "print(*{'torch', 'numba', 'numpy', 'gymnasium'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=True)
    assert done.stdout.strip() == ""
