"""Players and what is recorded of them: what a policy may not do, what changed files show, what a killed run leaves."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner, Result
from envcraft_privileged.players import RandomPlayer
from envcraft_tetris.family import TetrisFamily
from envcraft_tetris.placement import Game, Placement

from envcraft.cli.group import cli
from envcraft.contracts.builtin import GYMNASIUM
from envcraft.corpus.store import Environment, Store, demonstrations
from envcraft.demonstrations import format as form
from envcraft.demonstrations.store import load, save, verify
from envcraft.judging.settings import Settings, contract_digest
from envcraft.model.verdict import SubjectReport, Verdict

WHERE = ("--sandbox", "process", "--workers", "1")
VARIANT = "tetris_0_0000.py"
#: The way out is up after ten steps to the right; every step costs, so that nothing near it leads there.
MAZE = """
import threading

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Maze(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.lock = LOCK

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.steps = 0
        return self.render(), {"is_success": False}

    def step(self, action):
        self.steps += 1
        if action[0] == 4 and self.x < 10:
            self.x += 1
        out = bool(action[0] == 1 and self.x == 10)
        return self.render(), 1.0 if out else -0.01, out, self.steps >= 60, {"is_success": out}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[40:44, self.x * 8 : self.x * 8 + 4] = 255
        return frame
"""
#: Ends after nine steps, and has no frames.
COUNTER = """
import gymnasium as gym
from gymnasium import spaces


class Counter(gym.Env):
    def __init__(self):
        self.observation_space = spaces.Dict({"count": spaces.Discrete(10)})
        self.action_space = spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        return {"count": 0}, {}

    def step(self, action):
        self.count += 1
        return {"count": self.count}, float(action), self.count == 9, False, {}
"""
Demos = Callable[..., Result]


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    """Two variants of the family."""
    with Store.create(tmp_path / "corpus") as store:
        for one in TetrisFamily().generate(2, 0):
            store.add(f"{one.name}.py", one.source.encode(), origin={"family": "tetris", "seed": 0})
    return tmp_path / "corpus"


@pytest.fixture
def demos(corpus: Path, monkeypatch: pytest.MonkeyPatch) -> Demos:
    """Run ``envcraft demos`` on the first of them."""
    monkeypatch.chdir(corpus.parent)

    def run(*arguments: str) -> Result:
        return CliRunner().invoke(cli, ["demos", str(corpus), "--select", VARIANT, *WHERE, *arguments])

    return run


def recordings(corpus: Path) -> list[form.Recording]:
    with Store(corpus) as store:
        return [load(store, row) for _, row in demonstrations.named(store)]


def variants() -> list[Any]:
    """Environments of the first variants, of which some clear colours, some have walls, and some wrap around."""
    made = []
    for one in TetrisFamily().generate(12, 0):
        module = types.ModuleType(one.name)
        exec(compile(one.source, one.name, "exec"), vars(module))
        made.append(next(value for name, value in vars(module).items() if name.startswith("Tetris"))())
    return made


# The player of the family


def test_the_tetris_player_lasts_several_times_as_long_as_chance() -> None:
    ratios = []
    for env in variants()[:6]:
        lasted = []
        for chance in (True, False):
            env.reset(seed=3)
            env.action_space.seed(3)
            player = Placement()
            steps, ended = 0, False
            while not ended and steps < 400:
                move = env.action_space.sample() if chance else np.array(player.act(env))
                _, _, terminated, truncated, _ = env.step(move)
                steps, ended = steps + 1, terminated or truncated
            lasted.append(steps)
        ratios.append(lasted[1] / lasted[0])
    # Cut at 400 steps; benchmarks.tetris_players has the figure.
    assert float(np.median(ratios)) > 2.5


def test_it_changes_nothing_and_foresees_every_landing() -> None:
    for env in variants():
        env.reset(seed=1)
        player = Placement()
        for _ in range(60):
            before = [list(row) for row in env.board], env.np_random.bit_generator.state, dict(vars(env))
            move = player.act(env)
            assert (env.board, env.np_random.bit_generator.state) == before[:2]
            assert vars(env) == before[2]
            _, _, terminated, truncated, _ = env.step(np.array(move))
            if terminated or truncated:
                break
            # A piece that has not landed is where the stand-in is.
            if player._expected is not None and player._game is not None:
                player._game.follow(env)
                assert player._game.place() == player._expected


def test_it_finds_out_what_the_controls_do() -> None:
    for one in TetrisFamily().generate(12, 0):
        env = variants()[int(one.name[-4:])]
        env.reset(seed=0)
        controls = one.metadata["axes"]["controls"]
        told = {"cw": "turn 1", "ccw": "turn 3", "flip": "turn 2"}
        wanted = {told.get(controls[name], controls[name]) for name in ("up", "down", "first", "second")} - {""}
        assert set(Game(env)._controls) == wanted


# Recording


def test_recordings_are_small_and_reproducible(demos: Demos, corpus: Path) -> None:
    for player in ("random", "noop", "tetris"):
        done = demos("--steps", "150", "--player", player)
        assert (done.exit_code, done.stdout.split(":")[0]) == (0, player), done.output
        assert "recorded 150 steps in 1 environment" in done.stdout
    assert "in 0 environments, 1 already recorded" in demos("--steps", "150", "--player", "noop").stdout
    found = {recording.player: recording for recording in recordings(corpus)}
    assert {player: recording.steps for player, recording in found.items()} == dict.fromkeys(found, 150)
    assert found["noop"].table == [[0, 0, 0]]
    assert all(len(recording.to_bytes()) < 150 * 16 + 1000 for recording in found.values())
    again = demos("--verify")
    assert (again.exit_code, again.stdout) == (0, "played 3 recordings again; 0 environments failed\n")


def test_without_a_name_the_family_has_its_player(demos: Demos, corpus: Path) -> None:
    assert demos("--steps", "20").exit_code == 0
    assert [recording.player for recording in recordings(corpus)] == ["tetris"]


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        (
            "def policy(env):\n    env.steps = 0\n    return [0, 0, 0]",
            "EC804 the policy writes to the environment at st",
        ),
        ("def policy(env):\n    env.board[0][0] = 1\n    return [0, 0, 0]", "it changes board"),
        (
            "class P:\n    def act(self, state):\n        state.steps = 9",
            "EC804 the policy writes to the environment at",
        ),
        (
            "def policy(env):\n    env.np_random.random()\n    return [0, 0, 0]",
            "EC804 the policy's actions give another",
        ),
        ("def policy(env):\n    return [9, 0, 0]", "EC805 the policy's action 1 is invalid"),
        ("def policy(env):\n    return 1 / 0", "EC805 the policy raises ZeroDivisionError"),
    ],
)
def test_policy_that_writes_or_raises_is_not_recorded(
    policy: str, words: str, demos: Demos, corpus: Path, tmp_path: Path
) -> None:
    (tmp_path / "policy.py").write_text(policy)
    done = demos("--steps", "300", "--policy", str(tmp_path / "policy.py"))
    assert done.exit_code == 1, done.output
    assert words in done.stdout
    assert recordings(corpus) == []


def test_an_environment_that_differs_by_itself_is_not_recorded_and_its_policy_not_blamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    maze = MAZE.replace("LOCK", "None").replace("np.zeros((84, 84, 3), np.uint8)", "NOISE")
    maze = maze.replace("NOISE", "np.random.default_rng().integers(0, 99, (84, 84, 3), np.uint8)")
    with Store.create(tmp_path / "corpus") as store:
        store.add("maze.py", maze.encode())
    (tmp_path / "policy.py").write_text("def policy(env):\n    return [4 if env.x < 10 else 1, 0, 0]")
    done = CliRunner().invoke(cli, ["demos", "corpus", "--steps", "30", "--policy", "policy.py", *WHERE])
    assert done.exit_code == 3, done.output
    assert "the environment is not deterministic" in done.stdout
    assert "EC804" not in done.stdout
    assert recordings(tmp_path / "corpus") == []


def test_a_policy_that_only_reads_is_recorded(demos: Demos, corpus: Path, tmp_path: Path) -> None:
    (tmp_path / "policy.py").write_text("def policy(env):\n    return [3 if env.column > 2 else 4, 0, 0]")
    assert demos("--steps", "50", "--policy", str(tmp_path / "policy.py")).exit_code == 0
    assert [(found.player, found.steps) for found in recordings(corpus)] == [("policy", 50)]


def test_a_player_labels_the_states_of_another(tmp_path: Path) -> None:
    """Random play from a seed, labelled by the player of the family: a label is a pure function of what was played."""
    from envcraft_tetris.player import TetrisPlayer

    from envcraft.contracts.builtin import ARCADE
    from envcraft.demonstrations.recorder import advise
    from envcraft.judging.selection import driver_named
    from envcraft.model.target import Target

    [one] = TetrisFamily().generate(1, 0)
    target = Target(one.name, one.source.encode())
    actions = np.random.default_rng(0).integers(0, [5, 2, 2], (25, 3)).tolist()
    [env] = variants()[:1]
    env.reset(seed=4)
    player, wanted = Placement(), []
    for action in actions:
        wanted.append(list(player.act(env)))
        env.step(np.array(action))
    with contextlib.closing(driver_named("process")) as driver:
        [(number, advice, report)] = advise([target], TetrisPlayer(), ARCADE, driver, [[(4, actions)]], 1)
        assert (number, advice, report.verdict) == (0, [wanted], Verdict.PASS)
        # It answers the other's states, and did not play them.
        assert wanted != actions
        [(_, advice, report)] = advise([target], RandomPlayer(), ARCADE, driver, [[(4, actions)]], 1)
        assert advice == []
        assert "random does not advise on episodes of other players" in report.checks[-1].reason


def test_a_file_that_changed_is_found_and_can_be_taken_out(demos: Demos, corpus: Path) -> None:
    demos("--steps", "30", "--player", "noop")
    (file,) = corpus.rglob("*.demo")
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    assert (demos("--verify").exit_code, CliRunner().invoke(cli, ["corpus", "verify", str(corpus)]).exit_code) == (3, 1)
    mended = CliRunner().invoke(cli, ["corpus", "verify", "--repair", str(corpus)])
    assert mended.exit_code == 0, mended.output
    assert recordings(corpus) == []


def test_irreproducible_recording_is_a_finding(demos: Demos, corpus: Path) -> None:
    demos("--steps", "30", "--player", "noop")
    (before,) = recordings(corpus)
    # Whoever wrote another reward had the digests right.
    one = before.episodes[0]
    rewards = form.rewards(one).copy()
    rewards[7] += 1
    changed = msgspec.structs.replace(one, rewards=form.pack_rewards(rewards), digest="0" * 32)
    with Store(corpus, write=True) as store:
        save(store, msgspec.structs.replace(before, episodes=[changed]))
    done = demos("--verify")
    assert done.exit_code == 1
    assert f"{VARIANT}: EC201 episode 0 of the player noop, on seed {one.seed}, differs" in done.stdout
    assert "the reward differs at step 8" in done.stdout


def test_a_run_that_is_killed_goes_on_from_there(tmp_path: Path) -> None:
    with Store.create(tmp_path / "corpus") as store:
        for one in TetrisFamily().generate(5, 0):
            store.add(f"{one.name}.py", one.source.encode())
    command = [sys.executable, "-m", "envcraft", "demos", str(tmp_path / "corpus"), "--player", "random"]
    command += ["--steps", "800", *WHERE]
    begun = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until = time.monotonic() + 240
        # The file comes before its row: with a second one, the first is written down.
        while len(list((tmp_path / "corpus").rglob("*.demo"))) < 2 and time.monotonic() < until:
            time.sleep(0.01)
    finally:
        os.kill(begun.pid, signal.SIGKILL)
        begun.wait()
    with Store(tmp_path / "corpus") as store:
        kept = dict(store.db.execute("SELECT source, id FROM demonstrations"))
    assert 1 <= len(kept) < 5
    done = subprocess.run(command, capture_output=True, text=True, timeout=480, check=False)
    assert done.returncode == 0, done.stderr
    assert f"{5 - len(kept)} environment" in done.stdout
    with Store(tmp_path / "corpus") as store:
        found = dict(store.db.execute("SELECT source, id FROM demonstrations"))
        assert list(verify(store, repair=False)) == []
    assert len(found) == 5
    assert kept.items() <= found.items()


@pytest.mark.parametrize("lock", ["None", "threading.Lock()"], ids=["copied", "played again"])
def test_the_search_player_wins_where_chance_does_not(lock: str, tmp_path: Path) -> None:
    with Store.create(tmp_path / "corpus") as store:
        store.add("maze.py", MAZE.replace("LOCK", lock).encode())
    for player in ("random", "search"):
        arguments = ["demos", str(tmp_path / "corpus"), "--steps", "30", "--player", player, *WHERE]
        done = CliRunner().invoke(cli, arguments)
        assert done.exit_code == 0, done.output
    won = {found.player: found.episodes[0].success for found in recordings(tmp_path / "corpus")}
    assert won["search"] is True
    assert won["random"] is not True


# Frames


def test_the_cache_gives_the_frames_that_were_played(demos: Demos, corpus: Path) -> None:
    pytest.importorskip("zstandard")
    from envcraft.demonstrations.dataset import Demonstrations

    assert demos("--steps", "120", "--player", "random", "--cache").exit_code == 0
    (recording,) = recordings(corpus)
    env = variants()[0]
    number = 0
    read = Demonstrations(corpus)
    assert len(read) == 120
    for episode in recording.episodes:
        shown, _ = env.reset(seed=episode.seed)
        for action in recording.actions(episode):
            after, reward, *_ = env.step(np.array(action))
            found = read.transition(number)
            assert np.array_equal(found.observation, shown)
            assert np.array_equal(found.next_observation, after)
            assert (found.action.tolist(), found.reward) == (action, reward)
            shown, number = after, number + 1
    ends = np.cumsum([episode.steps for episode in recording.episodes])
    frames, following = (np.empty((3, 84, 84, 3), np.uint8) for _ in range(2))
    rest = read.read([0, ends[0] - 1, 119], frames, following)
    assert rest["terminated"].tolist() == [False, True, False]
    assert np.array_equal(following[1], read.transition(int(ends[0]) - 1).next_observation)
    with pytest.raises(IndexError):
        read.transition(120)


def test_the_cache_can_be_made_again_and_damage_shows(demos: Demos, corpus: Path) -> None:
    pytest.importorskip("zstandard")
    demos("--steps", "40", "--player", "noop", "--cache")
    (file,) = corpus.rglob("*.frames")
    data = file.read_bytes()
    file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    found = CliRunner().invoke(cli, ["corpus", "verify", str(corpus), "--repair"])
    assert "has changed since it was written" in found.stdout
    assert not file.exists()
    assert demos("--steps", "40", "--player", "noop", "--cache").exit_code == 0
    assert file.read_bytes() == data


def test_recording_uses_the_passed_contract_and_reports_missing_frames(tmp_path: Path) -> None:
    pytest.importorskip("zstandard")
    (tetris,) = TetrisFamily().generate(1, 0)
    with Store.create(tmp_path / "corpus") as store:
        store.add(VARIANT, tetris.source.encode())
        store.add("counter.py", COUNTER.encode())
        settings = Settings("gymnasium", contract_digest(GYMNASIUM), "rules", 0, "quick", "process", "python 3")
        sha256 = form.sha256(COUNTER.encode())
        report = SubjectReport("counter.py", "Counter", sha256, Verdict.PASS, "process", 0.1, 10, [])
        store.record(Environment("counter.py", sha256, ""), store.settings(settings), report)
    command = ["demos", str(tmp_path / "corpus"), "--player", "random", "--steps", "20", *WHERE]
    done = CliRunner().invoke(cli, command)
    assert done.exit_code == 0, done.output
    assert "random, gymnasium: recorded 20 steps in 1 environment" in done.stdout
    assert {found.contract for found in recordings(tmp_path / "corpus")} == {"arcade", "gymnasium"}
    cached = CliRunner().invoke(cli, [*command, "--cache"])
    assert cached.exit_code == 3, cached.output
    assert "counter.py: its observations are not arrays" in cached.stdout
    assert "played 2 recordings again for the cache; 1 environment failed" in cached.stdout
    # The one that has frames is there.
    assert len(list((tmp_path / "corpus").rglob("*.frames"))) == 1
    # Said again, since it is missing still; what was asked for outright is refused where it does not hold.
    assert CliRunner().invoke(cli, [*command, "--cache"]).exit_code == 3
    refused = CliRunner().invoke(cli, [*command, "--contract", "arcade", "--select", "counter"])
    assert refused.exit_code == 3, refused.output


# Minari


def test_minari_loads_what_is_exported_and_recovers_the_environment(
    demos: Demos, corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.chdir(tmp_path)
    # A relative one, as people type it.
    out = Path("kept", "minari")
    export = ("export", str(corpus), "--to", "minari", "--output", str(out), "--all")
    demos("--steps", "90", "--player", "random")
    refused = CliRunner().invoke(cli, export)
    assert (refused.exit_code, "--cache" in refused.output) == (2, True)
    demos("--steps", "90", "--player", "random", "--cache")
    done = CliRunner().invoke(cli, export)
    assert done.exit_code == 0, done.output
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(out.absolute()))
    monkeypatch.setenv("ENVCRAFT_CORPUS", str(corpus))
    name = "envcraft/tetris_0_0000/random-v0"
    assert list(minari.list_local_datasets()) == [name]
    dataset = minari.load_dataset(name)
    (recording,) = recordings(corpus)
    assert (dataset.total_steps, dataset.total_episodes) == (90, len(recording.episodes))
    with pytest.raises(Exception, match="no verdict"):
        dataset.recover_environment()
    env = dataset.recover_environment(trust=True)
    for episode, told in zip(dataset.iterate_episodes(), recording.episodes, strict=True):
        shown, _ = env.reset(seed=told.seed)
        for step, action in enumerate(episode.actions):
            assert np.array_equal(shown, episode.observations[step])
            shown, reward, terminated, *_ = env.step(action)
            assert (reward, terminated) == (episode.rewards[step], episode.terminations[step])
        assert np.array_equal(shown, episode.observations[-1])


# The report


def test_the_report_shows_what_came_out_by_player(demos: Demos, corpus: Path, tmp_path: Path) -> None:
    for needed in ("jinja2", "matplotlib", "PIL", "rensa"):
        pytest.importorskip(needed)
    from envcraft.corpus.report.players import player_rows

    for player in ("noop", "random"):
        demos("--steps", "200", "--player", player)
    with Store(corpus) as store:
        rows = player_rows(store)
    whole = {
        found.player: [one.steps for one in found.episodes if one.terminated or one.truncated]
        for found in recordings(corpus)
    }
    assert {row.name: (row.episodes, row.steps[1]) for row in rows} == {
        player: (len(steps), float(np.median(steps))) for player, steps in whole.items()
    }
    assert rows == sorted(rows, key=lambda row: row.steps[1])
    assert all(row.rate.n == row.episodes for row in rows)
    done = CliRunner().invoke(
        cli, ["corpus", "report", str(corpus), "--output", str(tmp_path / "site"), "--no-previews"]
    )
    assert done.exit_code == 0, done.output
    page = (tmp_path / "site" / "index.html").read_text("utf-8")
    assert '<section id="players">' in page
    assert page.count("<th>noop</th>") == 1


def test_of_a_player_that_has_changed_the_newest_counts(demos: Demos, corpus: Path) -> None:
    demos("--steps", "600", "--player", "noop")
    [before] = recordings(corpus)
    after = msgspec.structs.replace(before, player_digest="another", episodes=before.episodes[:1])
    with Store(corpus, write=True) as store:
        assert (
            len(list(demonstrations.outcomes(store)))
            == len([one for one in before.episodes if one.terminated or one.truncated])
            > 1
        )
        save(store, after)
        assert [one.steps for _, one in demonstrations.outcomes(store)] == [before.episodes[0].steps]
