"""A killed and resumed run gives the same agent, bit for bit."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from envcraft_dqn.settings import Settings

from envcraft.errors import EnvCraftError, UsageError

from .conftest import open_corridors
from .test_learner import Scripted

NAMES = ["left", "right", "left again"]
#: Small enough that the ring wraps around, and long enough to end cycles.
SETTINGS = Settings(
    size="tiny",
    device="cpu",
    steps=600,
    pretrain_updates=150,
    num_envs=2,
    cycle=100,
    segment=50,
    target_every=40,
    demonstrations=50,
    capacity=500,
)
_RUN = """
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

sys.path.insert(0, {root!r})
torch.set_num_threads(1)
from tests.plugins.dqn.conftest import open_corridors
from tests.plugins.dqn.test_learner import Scripted
from tests.plugins.dqn.test_resume import NAMES, SETTINGS
from envcraft_dqn.trainer import train

train(SETTINGS, NAMES, open_corridors, Path({folder!r}), Scripted(), every=0.0)
"""


def learnt(folder: Path) -> dict[str, bytes]:
    """The agent files of a run."""
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.safetensors"))}


def test_killed_run_resumes_to_the_same_agent(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    train(SETTINGS, NAMES, open_corridors, tmp_path / "whole", Scripted())
    killed = tmp_path / "killed"
    code = _RUN.format(root=str(Path(__file__).parents[3]), folder=str(killed))
    command = [sys.executable, "-c", code]
    state = killed / "checkpoint" / "state.json"
    positions = []
    for kill in (1, 2, None):
        before = state.read_bytes() if state.exists() else b""
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + 480
        while kill is not None and process.poll() is None and time.monotonic() < deadline:
            # During pretraining, then during training.
            there = json.loads(state.read_text()) if state.exists() else {"numbers": {"updates": 0, "turns": 0}}
            numbers = there["numbers"]
            if (numbers["updates"] >= 50) if kill == 1 else (numbers["turns"] >= 2):
                os.kill(process.pid, signal.SIGKILL)
                positions.append(numbers["updates"])
                break
            time.sleep(0.002)
        _, error = process.communicate(timeout=480)
        assert process.returncode == (0 if kill is None else -signal.SIGKILL), error
        assert state.read_bytes() != before
    assert positions[0] < SETTINGS.pretrain_updates < positions[1]
    assert learnt(killed) == learnt(tmp_path / "whole")
    assert set(learnt(killed)) == {"pretrained.safetensors", "agent.safetensors"}


def test_seed_determines_the_agent(tmp_path: Path) -> None:
    import msgspec
    from envcraft_dqn.trainer import train

    short = msgspec.structs.replace(SETTINGS, steps=200, pretrain_updates=0)
    one, same, other = (tmp_path / name for name in ("one", "same", "other"))
    train(short, NAMES, open_corridors, one)
    train(short, NAMES, open_corridors, same)
    train(msgspec.structs.replace(short, seed=1), NAMES, open_corridors, other)
    assert learnt(one) == learnt(same) != learnt(other)


def test_folder_of_another_run_is_refused(tmp_path: Path) -> None:
    import msgspec
    from envcraft_dqn.trainer import train

    short = msgspec.structs.replace(SETTINGS, steps=40, pretrain_updates=0, segment=10)
    train(short, NAMES, open_corridors, tmp_path)
    with pytest.raises(UsageError, match=r"a run with other settings \(batch 32, not 16\); choose another --output"):
        train(msgspec.structs.replace(short, batch=16), NAMES, open_corridors, tmp_path)
    with pytest.raises(UsageError, match="a run with other environments"):
        train(short, NAMES[:2], open_corridors, tmp_path)
    [part] = (tmp_path / "checkpoint").glob("learner-*")
    part.write_bytes(part.read_bytes()[:-100])
    with pytest.raises(EnvCraftError, match=r"cannot be read .* remove it to start over"):
        train(short, NAMES, open_corridors, tmp_path)


def test_run_of_a_version_with_fewer_settings_is_refused(tmp_path: Path) -> None:
    import msgspec
    from envcraft_dqn.trainer import train

    short = msgspec.structs.replace(SETTINGS, steps=20, pretrain_updates=0, segment=10)
    train(short, NAMES, open_corridors, tmp_path)
    file = tmp_path / "checkpoint" / "state.json"
    state = json.loads(file.read_text())
    del state["settings"]["value_rescaling"]
    file.write_text(json.dumps(state))
    with pytest.raises(UsageError, match=r"earlier version of EnvCraft, which had no setting value_rescaling; choose"):
        train(short, NAMES, open_corridors, tmp_path)


def test_run_keeps_the_precision_of_its_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import msgspec
    from envcraft_dqn import learner
    from envcraft_dqn.trainer import train
    from safetensors import safe_open

    def precision(file: Path) -> str:
        with safe_open(file, "np") as opened:
            return str(json.loads(opened.metadata()["envcraft"])["precision"])

    short = msgspec.structs.replace(SETTINGS, steps=20, pretrain_updates=0, segment=10)
    for fast in (True, False):
        monkeypatch.setattr(learner, "_faster_in_bf16", lambda device, fast=fast: fast)
        assert precision(train(short, NAMES, open_corridors, tmp_path)) == "bf16"
    assert json.loads((tmp_path / "checkpoint" / "state.json").read_text())["numbers"]["precision"] == "bf16"
    assert precision(train(short, NAMES, open_corridors, tmp_path / "other")) == "fp32"


@pytest.mark.parametrize(
    "change",
    [
        lambda state: [],
        lambda state: None,
        lambda state: {},
        lambda state: {**state, "settings": [1]},
        lambda state: {**state, "serial": []},
        lambda state: {**state, "numbers": 3},
        lambda state: {**state, "numbers": {**state["numbers"], "steps": "many"}},
        lambda state: {**state, "numbers": {**state["numbers"], "rng": {"bit_generator": "PCG64"}}},
        lambda state: {**state, "replay": {**state["replay"], "at": None}},
        lambda state: {**state, "files": {**state["files"], "replay": [None]}},
        lambda state: {**state, "files": {**state["files"], "learner": state["files"]["priorities"]}},
    ],
)
def test_invalid_state_is_reported(tmp_path: Path, change: Callable[[Any], Any]) -> None:
    import msgspec
    from envcraft_dqn.trainer import train

    short = msgspec.structs.replace(SETTINGS, steps=20, pretrain_updates=0, segment=10)
    train(short, NAMES, open_corridors, tmp_path)
    state = tmp_path / "checkpoint" / "state.json"
    state.write_text(json.dumps(change(json.loads(state.read_text()))))
    with pytest.raises(EnvCraftError, match=r"cannot be read .* remove it to start over|other settings"):
        train(short, NAMES, open_corridors, tmp_path)


@pytest.mark.parametrize(
    "metadata",
    [
        None,
        [],
        {"surface": 3, "size": "tiny", "head": "joint"},
        {"surface": {"shape": ["a"], "choices": [2]}, "size": "tiny", "head": "joint"},
        {"surface": {"shape": [16, 16, 3], "choices": [-2]}, "size": "tiny", "head": "joint"},
        {"surface": {"shape": [16], "choices": [2]}, "size": [], "head": "joint"},
    ],
)
def test_invalid_metadata_of_an_agent_is_reported(tmp_path: Path, metadata: Any) -> None:
    import safetensors.numpy
    from envcraft_dqn.checkpoint import load_agent

    file = tmp_path / "agent.safetensors"
    file.write_bytes(safetensors.numpy.save({}, {"envcraft": json.dumps(metadata)}))
    with pytest.raises(UsageError, match="is not an agent of `envcraft train`"):
        load_agent(file)
