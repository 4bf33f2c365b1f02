"""``envcraft play`` on a pseudo-terminal: the tests type keys and read the screen."""

from __future__ import annotations

import codecs
import contextlib
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

_WALK = '''
import os
import time

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Walk(gym.Env):
    """Seven steps to the right win."""

    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.goal = 0, 7
        self.noise = self.np_random.integers(0, 256, (84, 84, 3), dtype=np.uint8)
        return self.render(), {{}}

    def step(self, action):
        self.x += {{3: -1, 4: 1 + int(action[1])}}.get(int(action[0]), 0)
        {step}
        won = self.x >= self.goal
        return self.render(), float(won), won, False, {{"is_success": won}}

    def render(self):
        frame = self.noise // 2
        frame[40:44, self.x * 6 : self.x * 6 + 6] = 255
        return frame
'''


class Console:
    """The command in a terminal of 80 columns and 43 lines."""

    def __init__(self, *arguments: str | Path, folder: Path) -> None:
        self.master, slave = pty.openpty()
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", 43, 80, 0, 0))
        self.before = termios.tcgetattr(slave)
        self.slave = slave
        command = [sys.executable, "-m", "envcraft", "play", *map(str, arguments)]
        variables = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
        self.process = subprocess.Popen(
            command, stdin=slave, stdout=slave, stderr=slave, cwd=folder, start_new_session=True, env=variables
        )
        self.text = ""
        self._decoder = codecs.getincrementaldecoder("utf-8")()

    def type(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def expect(self, words: str, seconds: float = 120) -> str:
        """Wait for these words; return the output between the previous words and these."""
        deadline = time.monotonic() + seconds
        while words not in self.text:
            if not select.select([self.master], [], [], max(deadline - time.monotonic(), 0))[0]:
                raise AssertionError(f"{words!r} did not come after {self.text[-2000:]!r}")
            self._read()
        said, _, self.text = self.text.partition(words)
        return said

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            self.text += self._decoder.decode(os.read(self.master, 1 << 16))

    def ended(self) -> int:
        """Wait for the end; return the exit status. The terminal must have its former settings."""
        deadline = time.monotonic() + 120
        while self.process.poll() is None:
            assert time.monotonic() < deadline, self.text[-2000:]
            if select.select([self.master], [], [], 0.1)[0]:
                self._read()
        while select.select([self.master], [], [], 0)[0]:
            self._read()
        assert termios.tcgetattr(self.slave) == self.before
        return self.process.returncode

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.master)
        os.close(self.slave)


Opened = Callable[..., Console]


@pytest.fixture
def console(tmp_path: Path) -> Iterator[Opened]:
    opened: list[Console] = []

    def make(*arguments: str | Path) -> Console:
        opened.append(Console(*arguments, folder=tmp_path))
        return opened[-1]

    yield make
    for one in opened:
        one.close()


@pytest.fixture
def walk(tmp_path: Path) -> Callable[[str], Path]:
    def write(step: str = "pass") -> Path:
        (tmp_path / "walk.py").write_text(_WALK.format(step=step))
        return tmp_path / "walk.py"

    return write


def envcraft(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "envcraft", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=480, check=False)


@pytest.mark.parametrize(
    "sandbox", ["process", pytest.param("bubblewrap", marks=pytest.mark.bubblewrap)], ids=["process", "bubblewrap"]
)
def test_an_episode_in_turns_is_recorded_and_replayed(console: Opened, walk: Any, tmp_path: Path, sandbox: str) -> None:
    walk()
    game = console("walk.py", "--sandbox", sandbox, "--turn-based", "--output", "played.json")
    game.expect("Walk, seed 0: step 0, return 0")
    game.expect("Seven steps to the right win.")
    game.expect("press a key to play")
    # Left by three keys, a button with the following move, and right by three keys.
    game.type("a\x1b[Dhxd\x1b[Cl\r" + "d" * 20)
    game.expect("Walk, seed 0: ended, success, return 1, 13 steps")
    game.type("r")
    game.expect("Walk, seed 1: step 0")
    game.type("dd")
    game.expect("step 2")
    game.type("q")
    assert game.ended() == 0
    said = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", game.text)
    assert "a person played seed 0: ended, success, return 1, 13 steps" in said
    assert "a person played seed 1: stopped, no success, return 0, 2 steps" in said

    report = json.loads((tmp_path / "played.json").read_text())
    [subject] = report["reports"]
    [played] = [check for check in subject["checks"] if check["check"] == "play"]
    first, second = played["findings"]
    right = [4, 0, 0]
    assert first["repro"]["actions"] == [*[[3, 0, 0]] * 3, [4, 1, 0], right, right, [0, 0, 0], *[right] * 6]
    assert (second["repro"]["seed"], second["repro"]["actions"]) == (1, [right, right])

    again = envcraft(tmp_path, "replay", "played.json", "--sandbox", "process")
    assert again.returncode == 0, again.stderr
    assert again.stdout.count("reproduced: a person played") == 2
    picture = envcraft(tmp_path, "replay", "played.json", "--finding", "2", "--gif", "walk.gif")
    assert (picture.returncode, (tmp_path / "walk.gif").exists()) == (0, True), picture.stderr


def test_it_fits_the_terminal_in_real_time_and_goes_on_by_itself(console: Opened, walk: Any, tmp_path: Path) -> None:
    walk()
    game = console("walk.py", "--sandbox", "process", "--fps", "30", "--output", "played.json")
    screen = game.expect("step 0, return 0")
    assert "\x1b[?1049h" in screen
    # The game waits while its description is read, at the start and after "?".
    game.expect("press a key to play")
    game.type(" ")
    screen = game.expect("step 10")
    game.type("?")
    game.expect("Seven steps to the right win.")
    game.type("x")
    game.expect("step 1")
    rows: dict[int, str] = {}
    for number, row in re.findall(r"\x1b\[(\d+);1H((?:\x1b\[[0-9;]*m|▀)+)", screen):
        rows.setdefault(int(number), row)
    assert list(rows) == list(range(1, 41))
    assert {row.count("▀") for row in rows.values()} == {80}
    game.type("\x1b")
    assert game.ended() == 0
    report = json.loads((tmp_path / "played.json").read_text())
    actions = report["reports"][0]["checks"][0]["findings"][0]["repro"]["actions"]
    assert len(actions) >= 10
    assert {tuple(action) for action in actions} <= {(0, 0, 0), (0, 1, 0)}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_terminal_is_restored_and_the_episode_kept(
    console: Opened, walk: Any, tmp_path: Path, number: signal.Signals
) -> None:
    walk()
    game = console("walk.py", "--sandbox", "process", "--turn-based", "--output", "played.json")
    game.expect("step 0")
    game.type("d")
    game.expect("step 1")
    game.process.send_signal(number)
    assert game.ended() == 130
    assert "\x1b[?1049l" in game.text
    report = json.loads((tmp_path / "played.json").read_text())
    assert report["reports"][0]["checks"][0]["findings"][0]["repro"]["actions"] == [[4, 0, 0]]


@pytest.mark.parametrize(
    ("step", "code", "words"),
    [
        ("1 / (self.x - 2)", "EC107", "step 2 raises ZeroDivisionError"),
        ("while self.x == 2: time.sleep(0.1)", "EC901", "step 2 did not end"),
        ("self.x == 2 and os._exit(1)", "EC906", "the process died in step 2"),
    ],
)
def test_what_goes_wrong_is_a_finding(
    console: Opened, walk: Any, tmp_path: Path, step: str, code: str, words: str
) -> None:
    walk(step)
    game = console("walk.py", "--sandbox", "process", "--turn-based", "--output", "played.json")
    game.expect("step 0")
    game.type("ddd")
    game.expect(words)
    game.expect("usual fix: ")
    game.type("q")
    assert game.ended() == 1
    report = json.loads((tmp_path / "played.json").read_text())
    [subject] = report["reports"]
    assert subject["verdict"] == "fail"
    found = [finding for check in subject["checks"] for finding in check["findings"]]
    assert [finding["code"] for finding in found] == ["EC000", code]
    assert found[1]["repro"]["actions"] == [[4, 0, 0], [4, 0, 0]]
    again = envcraft(tmp_path, "replay", "played.json", "--sandbox", "process")
    assert again.returncode == 0, again.stdout


def test_what_cannot_be_loaded_is_no_game(console: Opened, tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("import gymnasium\nimport nunpy\n\nclass Bad(gymnasium.Env):\n    pass\n")
    game = console("bad.py", "--sandbox", "process")
    assert game.ended() == 1
    assert "EC002" in game.text
    assert "\x1b[?1049h" not in game.text


def test_rendered_frames_and_keys_by_action(console: Opened, tmp_path: Path) -> None:
    pytest.importorskip("pygame")
    game = console("CartPole-v1", "--contract", "gymnasium", "--sandbox", "process", "--output", "played.json")
    screen = game.expect("step 0")
    assert "▀" in screen
    game.expect("1: 0   2: 1")
    game.expect("each step waits for a key")
    game.type("2" * 30)
    game.expect("CartPoleEnv, seed 0: ended")
    game.type("q")
    assert game.ended() == 0
    again = envcraft(tmp_path, "replay", "played.json", "--sandbox", "process")
    assert again.returncode == 0, again.stdout + again.stderr


def test_without_a_terminal_it_is_a_sentence(walk: Any, tmp_path: Path) -> None:
    walk()
    result = envcraft(tmp_path, "play", "walk.py", "--terminal")
    assert result.returncode == 2
    assert result.stderr == ("Error: standard input and output must be a terminal; use one, or play in a --window\n")
