"""``envcraft.make_vec`` beside Gymnasium's own ``SyncVectorEnv``, and what follows a failure."""

from __future__ import annotations

import copyreg
import itertools
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import envcraft
from envcraft.environments.infos import plain
from envcraft.environments.sources import Untrusted
from envcraft.environments.vector import NamedVectorEnv
from envcraft.errors import EnvironmentFailed, UsageError

from .conftest import game

NAMES = ["ant", "bee", "cat", "deep/dog"]
Started = Callable[..., NamedVectorEnv]


def same(one: Any, two: Any) -> bool:
    """Whether two infos are the same, types of arrays included."""
    if isinstance(one, dict):
        return isinstance(two, dict) and set(one) == set(two) and all(same(one[key], two[key]) for key in one)
    if isinstance(one, np.ndarray) and one.dtype == object:
        return one.shape == two.shape and all(same(left, right) for left, right in zip(one, two, strict=True))
    if isinstance(one, np.ndarray):
        return one.dtype == two.dtype and bool(np.array_equal(one, two))
    return bool(one == two)


def peer(corpus: Path, mode: AutoresetMode, count: int) -> Any:
    makers = [partial(envcraft.make, corpus, NAMES[index % len(NAMES)]) for index in range(count)]
    return SyncVectorEnv(makers, autoreset_mode=mode)


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_it_does_what_gymnasiums_own_does(corpus: Path, mode: AutoresetMode, workers: int) -> None:
    ours: Any = envcraft.make_vec(NAMES, 5, corpus=corpus, autoreset_mode=mode, workers=workers)
    theirs = peer(corpus, mode, 5)
    assert ours.metadata["autoreset_mode"] is mode
    for name in ("observation_space", "action_space", "single_observation_space", "single_action_space", "num_envs"):
        assert getattr(ours, name) == getattr(theirs, name), name
    seeds = [3, 1, 4, 1, 5]
    first = ours.reset(seed=seeds), theirs.reset(seed=seeds)
    assert np.array_equal(first[0][0], first[1][0])
    assert same(first[1][1], first[0][1])
    theirs.action_space.seed(0)
    ends = 0
    for step in range(30):
        actions = theirs.action_space.sample()
        mine, other = ours.step(actions), theirs.step(actions)
        for at, name in enumerate(("observations", "rewards", "terminated", "truncated")):
            assert mine[at].dtype == other[at].dtype
            assert np.array_equal(mine[at], other[at]), (step, name)
        assert same(other[4], mine[4]), (step, other[4], mine[4])
        ended = other[2] | other[3]
        ends += ended.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            with pytest.raises(ResetNeeded, match=f"environments {np.flatnonzero(ended)[0]}"):
                ours.step(actions)
            mine, other = (one.reset(options={"reset_mask": ended.copy()}) for one in (ours, theirs))
            assert np.array_equal(mine[0], other[0])
            assert same(other[1], mine[1])
    assert ends > 10
    assert ours.reset(seed=8)[0].tobytes() == theirs.reset(seed=8)[0].tobytes()
    assert len(ours.render()) == 5
    ours.close()


@pytest.fixture
def started(corpus: Path, monkeypatch: pytest.MonkeyPatch) -> Started:
    def start(*names: str, **more: Any) -> NamedVectorEnv:
        return envcraft.make_vec(list(names) or NAMES, **{"corpus": corpus, "workers": 2, **more})

    return start


def pids(vector: NamedVectorEnv) -> list[int]:
    return [process.pid for process in vector.unwrapped.processes]  # type: ignore[attr-defined] # of AsyncVectorEnv


class TestUse:
    def test_observations_are_copies_unless_none_are_wanted(self, started: Started) -> None:
        for copy in (True, False):
            with_copy = started("ant", "bee", workers=0, copy=copy)
            first, _ = with_copy.reset(seed=0)
            before = first.copy()
            with_copy.step(np.ones((2, 3), np.int64))
            assert np.array_equal(first, before) is copy

    def test_gymnasiums_wrappers_take_it(self, started: Started) -> None:
        wrapped = RecordEpisodeStatistics(started(autoreset_mode="SameStep"))
        wrapped.reset(seed=0)
        lengths: deque[int] = deque()
        for _ in range(12):
            info = wrapped.step(wrapped.action_space.sample())[4]
            lengths += [int(length) for length in info["episode"]["l"][info["_episode"]]] if "episode" in info else []
        wrapped.close()
        assert {5, 7, 9, 11} <= set(lengths)

    def test_wrong_actions_seeds_masks_and_names(self, started: Started) -> None:
        vector = started("ant", "bee", workers=0)
        with pytest.raises(ResetNeeded):
            vector.step(np.zeros((2, 3), np.int64))
        with pytest.raises(ValueError, match="3 seeds for 2"):
            vector.reset(seed=[1, 2, 3])
        with pytest.raises(ValueError, match="the seed -1"):
            vector.reset(seed=-1)
        vector.reset()
        with pytest.raises(ValueError, match=r"shape \(3,\), not \(2, 3\)"):
            vector.step(np.zeros(3, np.int64))
        with pytest.raises(TypeError, match="same_kind"):
            vector.step(np.zeros((2, 3)))
        with pytest.raises(ValueError, match="boolean array"):
            vector.reset(options={"reset_mask": [True, False]})
        with pytest.raises(UsageError, match="no autoreset mode 'Never'"):
            started(autoreset_mode="Never")
        with pytest.raises(UsageError, match="no environment eel"):
            started("eel")
        with pytest.raises(UsageError, match="workers=-1"):
            started(workers=-1)
        vector.step(np.zeros((2, 3), np.int64))

    def test_what_names_no_environment_is_a_sentence(self, corpus: Path) -> None:
        names: Any = Path
        with pytest.raises(UsageError, match=r"Path'> is not the name of an environment, and not a file"):
            envcraft.make_vec(names)
        count: Any = ["ant"]
        with pytest.raises(
            UsageError, match=r"num_envs is \['ant'\], .* as one list first, and their corpus as corpus="
        ):
            envcraft.make_vec(corpus, count)
        with pytest.raises(UsageError, match="make_vec has no names; give at least one"):
            envcraft.make_vec([])
        with pytest.raises(UsageError, match="num_envs is 0; it must be 1 or more"):
            envcraft.make_vec(["ant"], 0)

    def test_where_names_are_looked_up(self, corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        monkeypatch.delenv("ENVCRAFT_CORPUS", raising=False)
        with pytest.raises(UsageError, match=r"ant is not a file, and .* give corpus=, or set ENVCRAFT_CORPUS"):
            envcraft.make_vec(["ant"], workers=0)
        (tmp_path / "ant.py").write_text(game("Here"))
        monkeypatch.setenv("ENVCRAFT_CORPUS", str(corpus))
        assert envcraft.make_vec("ant.py", corpus=corpus, workers=0).names == ("ant.py",)
        assert envcraft.make_vec(["bee", "cat"], 3, workers=0).names == ("bee.py", "cat.py", "bee.py")
        with pytest.raises(Untrusted, match=r"`envcraft validate ant\.py` judges it"):
            envcraft.make_vec("ant.py", workers=0)

    @pytest.mark.parametrize("workers", [0, 1])
    def test_environments_with_other_spaces_are_refused(self, started: Started, workers: int) -> None:
        with pytest.raises(UsageError, match=r"observation space of point\.py is .*must have the same spaces"):
            started("ant", "point", workers=workers)

    def test_spaces_of_other_kinds(self, started: Started) -> None:
        vector = started("point", num_envs=2, workers=1, autoreset_mode="SameStep")
        assert vector.single_action_space == gymnasium.spaces.Discrete(3, start=-1)
        observations, _ = vector.reset(seed=0)
        assert observations.dtype == np.float32
        for _ in range(20):
            told = vector.step(np.array([-1, 1]))[4]
            if "final_obs" in told:
                assert told["final_obs"][0].dtype == np.float32
                break
        else:
            pytest.fail("no episode ended")
        vector.close()

    def test_processes_end_with_the_vector(self, started: Started) -> None:
        vector = started()
        running = pids(vector)
        assert len(running) == 4
        vector.close()
        vector.close()
        assert not [pid for pid in running if Path(f"/proc/{pid}").exists()]
        with pytest.raises(ClosedEnvironmentError, match="closed"):
            vector.reset()

    def test_processes_end_with_a_vector_that_nobody_closed(self, started: Started) -> None:
        vector = started()
        running = pids(vector)
        del vector
        assert not [pid for pid in running if Path(f"/proc/{pid}").exists()]

    def test_it_has_the_render_mode_of_its_environments(self, started: Started) -> None:
        for given, mode in ((None, "rgb_array"), ("human", "human")):
            assert started(workers=0, render_mode=given).render_mode == mode


class TestFailures:
    """An environment fails on one action: the message names it, and nothing is left running."""

    @pytest.fixture
    def failing(self, tmp_path: Path) -> Callable[..., NamedVectorEnv]:
        def start(body: str, **more: Any) -> NamedVectorEnv:
            (tmp_path / "bad.py").write_text(game("Bad", "self.steps >= 9", f"if action[2]:\n            {body}"))
            (tmp_path / "good.py").write_text(game("Good"))
            names = [tmp_path / "good.py", tmp_path / "bad.py", tmp_path / "good.py"]
            vector = envcraft.make_vec(names, trust=True, **{"workers": 2, **more})
            vector.reset(seed=0)
            return vector

        return start

    @pytest.mark.parametrize("workers", [0, 2])
    @pytest.mark.parametrize(
        ("body", "words"),
        [
            ("raise ZeroDivisionError('by none')", r"raised in step\(\): ZeroDivisionError: by none"),
            ("raise SystemExit(3)", r"raised in step\(\): SystemExit: 3"),
            ("raise type('Mute', (Exception,), {'__str__': None})()", r"raised in step\(\): Mute"),
            ("return np.zeros((84, 84, 1), np.uint8), 0.0, False, False, {}", r"shape \(84, 84, 1\)"),
            ("return self.render() / 2, 0.0, False, False, {}", "same_kind"),
            ("return self.render(), None, False, False, {}", "TypeError"),
            ("return self.render(), 0.0, False, False, None", "info is of type NoneType"),
        ],
    )
    def test_an_environment_raises(
        self, failing: Callable[..., NamedVectorEnv], body: str, words: str, workers: int
    ) -> None:
        vector = failing(body, workers=workers)
        vector.step(np.zeros((3, 3), np.int64))
        with pytest.raises(EnvironmentFailed, match=rf"environment 1 \(.*bad\.py\) .*{words}"):
            vector.step(np.ones((3, 3), np.int64))
        assert vector.closed

    def test_the_cause_of_an_error_cannot_be_pickled(
        self, failing: Callable[..., NamedVectorEnv], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        # As tblib does, which distributed installs for its whole process.
        def reduce(error: EnvironmentFailed) -> tuple[Any, ...]:
            return EnvironmentFailed, error.args, {"__cause__": error.__cause__}

        monkeypatch.setitem(copyreg.dispatch_table, EnvironmentFailed, reduce)
        vector = failing("raise type('Mute', (Exception,), {})()")
        with pytest.raises(EnvironmentFailed, match="Mute"):
            vector.step(np.ones((3, 3), np.int64))

    def test_an_environment_raises_in_a_process(self, failing: Callable[..., NamedVectorEnv]) -> None:
        vector = failing("raise ZeroDivisionError('by none')")
        running = pids(vector)
        with pytest.raises(EnvironmentFailed, match=r"environment 1 \(.*bad\.py\).*ZeroDivisionError") as caught:
            vector.step(np.ones((3, 3), np.int64))
        assert "in step" in caught.value.__notes__[0]
        assert vector.closed
        assert not [pid for pid in running if Path(f"/proc/{pid}").exists()]

    @pytest.mark.parametrize(
        ("body", "words"),
        [("import os; os._exit(4)", "exit status 4"), ("import os; os.kill(os.getpid(), 9)", "signal 9")],
    )
    def test_an_environment_ends_its_process(
        self, failing: Callable[..., NamedVectorEnv], body: str, words: str
    ) -> None:
        vector = failing(body)
        with pytest.raises(EnvironmentFailed, match=rf"environment 1 \(.*bad\.py\) ended its process \({words}\)"):
            vector.step(np.ones((3, 3), np.int64))
        assert vector.closed

    def test_a_process_is_killed_between_steps(self, started: Started) -> None:
        vector = started()
        vector.reset(seed=0)
        os.kill(pids(vector)[1], signal.SIGKILL)
        with pytest.raises(EnvironmentFailed, match=r"environment 1 \(bee\.py\) ended its process \(signal 9\)"):
            vector.step(np.zeros((4, 3), np.int64))

    def test_an_environment_cannot_be_made(self, tmp_path: Path) -> None:
        (tmp_path / "bad.py").write_text("import gymnasium\nraise RuntimeError('early')\n")
        (tmp_path / "good.py").write_text(game("Good"))
        for workers in (0, 2):
            with pytest.raises(EnvironmentFailed, match=r"bad\.py cannot be imported: RuntimeError: early"):
                envcraft.make_vec([tmp_path / "good.py", tmp_path / "bad.py"], trust=True, workers=workers)

    def test_ctrl_c_during_a_step_ends_the_processes(self, started: Started) -> None:
        vector = started()
        vector.reset(seed=0)
        running = pids(vector)
        timer = threading.Timer(0.3, signal.raise_signal, [signal.SIGINT])
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            deque((vector.step(np.zeros((4, 3), np.int64)) for _ in itertools.count()), 0)
        timer.join()
        assert vector.closed
        assert not [pid for pid in running if Path(f"/proc/{pid}").exists()]

    def test_workers_end_when_their_parent_is_killed(self, corpus: Path, tmp_path: Path) -> None:
        code = (
            "import envcraft, os, signal\n"
            f"vector = envcraft.make_vec(['ant'], corpus={str(corpus)!r}, workers=1)\n"
            "print(vector.unwrapped.processes[0].pid, flush=True)\n"
            "os.kill(os.getpid(), signal.SIGKILL)\n"
        )
        told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=False)
        pid = int(told.stdout)
        assert told.returncode == -signal.SIGKILL
        deadline = time.monotonic() + 120
        while Path(f"/proc/{pid}").exists() and Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z":
            assert time.monotonic() < deadline
            time.sleep(0.05)


def test_games_may_mean_different_things_by_one_key(tmp_path: Path) -> None:
    told = [
        "{'v': 3, 'n': 1, 'd': {'x': 1}, 'a': np.zeros(2), 's': np.str_('')}",
        "{'v': None, 'n': 0.5, 'd': 3, 'a': np.zeros(3), 's': 'far'}",
        "{'v': 'far', 'n': 2**70, 'd': {'x': 'y'}, 's': 2}",
        "{'d': True}",
    ]
    for number, info in enumerate(told):
        body = f"return self.render(), 0.0, False, False, {info}"
        (tmp_path / f"g{number}.py").write_text(game(f"G{number}", body=body))
    files = [tmp_path / f"g{number}.py" for number in range(len(told))]
    for workers in (0, 2):
        vector = envcraft.make_vec(files, trust=True, contract="arcade-native", workers=workers)
        vector.reset(seed=0)
        infos = vector.step(np.zeros((4, 3), np.int64))[4]
        vector.close()
        assert infos["v"].tolist() == [3, None, "far", None]
        assert infos["_v"].tolist() == [True, True, True, False]
        assert infos["n"].tolist() == [1, 0.5, 2**70, None]
        assert infos["d"].tolist() == [{"x": 1}, 3, {"x": "y"}, True]
        assert [None if one is None else one.shape for one in infos["a"]] == [(2,), (3,), None, None]
        assert infos["s"].tolist() == ["", "far", 2, None]


def test_whole_numbers_and_others_share_a_column(tmp_path: Path) -> None:
    for number, value in enumerate(("3", "0.5")):
        body = f"return self.render(), 0.0, False, False, {{'v': {value}}}"
        (tmp_path / f"g{number}.py").write_text(game(f"G{number}", body=body))
    vector = envcraft.make_vec([tmp_path / "g0.py", tmp_path / "g1.py"], trust=True, workers=0)
    vector.reset(seed=0)
    column = vector.step(np.zeros((2, 3), np.int64))[4]["v"]
    assert column.dtype == np.float64
    assert column.tolist() == [3.0, 0.5]


class TestInfos:
    def test_processes_send_plain_data(self) -> None:
        loop: dict[str, Any] = {}
        loop["loop"] = loop
        info: dict[Any, Any] = {
            "numbers": [1, 2.5, True, None, 2**80, np.float32(1.5), np.array([1, 2])],
            "object": object(),
            "array": np.array([object()]),
            "mode": AutoresetMode.DISABLED,
            (1, 2): ("text", 3),
            "loop": loop,
        }
        sent = plain(info)
        assert same(sent["numbers"][:6], info["numbers"][:6])
        assert sent["numbers"][6].tolist() == [1, 2]
        assert sent["object"] == {"type": "object"}
        assert sent["array"] == {"type": "numpy.ndarray"}
        assert sent["mode"] == {"type": "gymnasium.vector.vector_env.AutoresetMode"}
        assert sent["(1, 2)"] == ["text", 3]
        assert pickle.loads(pickle.dumps(sent)).keys() == sent.keys()

    def test_what_a_file_defines_stays_in_its_process(self, tmp_path: Path) -> None:
        (tmp_path / "game.py").write_text(game(body="self.steps += 0\n        class Own: pass", end="False"))
        text = (tmp_path / "game.py").read_text().replace('"score": self.score', '"score": Own()')
        (tmp_path / "game.py").write_text(text)
        vector = envcraft.make_vec([tmp_path / "game.py"], 2, trust=True, workers=2)
        vector.reset(seed=0)
        info = vector.step(np.zeros((2, 3), np.int64))[4]
        vector.close()
        assert "Own" in info["score"]["type"][1]
