"""What ``envcraft play`` is made of: keys, pictures and the window; tests/e2e/test_play.py plays for real."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envcraft.cli.play.description import describe
from envcraft.cli.play.keys import Keys, Pad, keys_for
from envcraft.cli.play.picture import Picture, fit, half_blocks
from envcraft.cli.play.screen import Screen
from envcraft.contracts.builtin import ARCADE, GYMNASIUM
from envcraft.errors import UsageError
from envcraft.spaces.spec import read_space

BOX = {"type": "Box", "low": -2.0, "high": 0.5, "shape": [2], "dtype": "float32"}


#: An environment of numbers whose render() fails.
BLIND = """
import gymnasium
import numpy as np


class Blind(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
    observation_space = gymnasium.spaces.Box(0, 1, (2,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(2, np.float32), {}

    def step(self, action):
        return np.zeros(2, np.float32), 0.0, False, False, {}

    def render(self):
        raise RuntimeError("no display")
"""


class Quitting(Screen):
    """A person who leaves once there is something to see."""

    seen = False

    def __exit__(self, *_: object) -> None:
        pass

    def show(self, picture: Picture | None, lines: Sequence[str]) -> None:
        assert picture is None
        self.seen = True

    def pressed(self, seconds: float) -> list[str]:
        time.sleep(seconds)
        return ["q"] if self.seen else []

    def held(self) -> list[str]:
        return []


def gymnasium_keys(space: dict[str, Any]) -> Keys:
    return keys_for(GYMNASIUM, read_space(space))


class TestKeys:
    def test_the_pad_in_real_time(self) -> None:
        pad = keys_for(ARCADE, read_space(ARCADE.action))
        assert isinstance(pad, Pad)
        assert pad.held([]) == [0, 0, 0]
        assert [pad.held([key])[0] for key in ("up", "s", "h", "right")] == [1, 2, 3, 4]
        assert pad.held(["left", "z", "up", "space"]) == [1, 1, 1]

    def test_the_pad_in_turns(self) -> None:
        pad = Pad()
        assert [pad.turn(key) for key in ("x", "c", "d", "d", "enter", "p")] == [
            None,
            None,
            [4, 1, 1],
            [4, 0, 0],
            [0, 0, 0],
            None,
        ]

    def test_every_contract_but_arcade_gets_a_key_for_each_action(self) -> None:
        keys = gymnasium_keys({"type": "Discrete", "n": 3, "start": 5})
        assert [keys.turn(key) for key in ("1", "3", "4", "q")] == [5, 7, None, None]
        assert keys.help[0] == "1: 5   2: 6   3: 7"
        assert not keys.idle
        pad = gymnasium_keys(ARCADE.action or {})
        assert (pad.turn("1"), pad.turn("2")) == ([0, 0, 0], [0, 0, 1])
        bits = gymnasium_keys({"type": "MultiBinary", "shape": [2]})
        assert [bits.turn(key) for key in "1234"] == [[0, 0], [1, 0], [0, 1], [1, 1]]

    def test_a_small_box_is_played_by_its_sides(self) -> None:
        keys = gymnasium_keys(BOX)
        assert keys.turn("1") == [-0.25, -0.25]
        assert keys.turn("2") == [-1.0, -0.25]
        assert keys.turn("5") == [-0.25, 0.5]
        assert keys.help[0] == "1: middle   2: 0 low   3: 0 high   4: 1 low   5: 1 high"

    @pytest.mark.parametrize(
        ("space", "words"),
        [
            ({**BOX, "shape": [3, 3]}, "it has 9 numbers, and up to 8"),
            ({"type": "Discrete", "n": 40, "start": 0}, "more than 34 actions, and there are no more keys"),
            ({"type": "MultiBinary", "shape": [6]}, "more than 34 actions"),
            ({"type": "MultiBinary", "shape": [20_000]}, "more than 34 actions"),
            ({"type": "Tuple", "spaces": []}, "only Discrete, MultiDiscrete, MultiBinary and small Box"),
        ],
    )
    def test_what_no_keyboard_plays_is_a_sentence(self, space: dict[str, Any], words: str) -> None:
        with pytest.raises(UsageError, match=words):
            gymnasium_keys(space)


class TestDescription:
    def test_the_longer_docstring_of_class_and_file(self) -> None:
        source = (
            b'"""Two rooms."""\nclass Rooms:\n    """Find the key, then open the door.\n\n    A wall is a wall."""\n'
        )
        assert describe(source, "Rooms") == ["Find the key, then open the door.", "", "A wall is a wall."]
        assert describe(source, None) == ["Two rooms."]
        assert describe(b"class Rooms: pass\n", "Rooms") == []
        assert describe(b"class Rooms(\n", "Rooms") == []

    def test_paragraphs_are_wrapped_and_lists_are_kept(self) -> None:
        text = "word " * 20 + "\n\nActions:\n- 0 waits\n- 1 walks\n"
        lines = describe(f'"""{text}"""'.encode(), None)
        assert all(len(line) <= 76 for line in lines)
        assert lines[2:] == ["", "Actions:", "- 0 waits", "- 1 walks"]

    def test_goal_and_controls_come_first(self) -> None:
        source = b'"""A maze.\n\nDark.\n\nGoal: find the exit.\n\nControls: arrows walk.\n\nRewards: 1."""'
        lines = ["Goal: find the exit.", "", "Controls: arrows walk.", "", "A maze.", "", "Dark.", "", "Rewards: 1."]
        assert describe(source, None) == lines

    def test_a_long_one_leaves_room_for_the_picture(self) -> None:
        lines = describe(('"""' + "a\n\n" * 40 + '"""').encode(), None)
        assert len(lines) == 18
        assert lines[-1] == "…"

    def test_no_escape_reaches_the_terminal(self) -> None:
        assert describe(rb'"red \x1b[31m"', None) == ["red \N{REPLACEMENT CHARACTER}[31m"]


class TestPictures:
    def test_a_smaller_one_is_the_mean_of_areas(self) -> None:
        picture = np.zeros((84, 84, 3), np.uint8)
        picture[:, 42:] = 200
        small = fit(picture, 80, 80)
        assert small.shape == (80, 80, 3)
        assert (small[0, 39].tolist(), small[0, 40].tolist()) == ([0, 0, 0], [200, 200, 200])
        assert abs(float(small.mean()) - float(picture.mean())) < 0.5
        assert fit(np.full((400, 600, 3), 7, np.uint8), 80, 80).shape == (53, 80, 3)

    def test_a_larger_one_is_a_whole_multiple(self) -> None:
        assert fit(np.zeros((9, 9, 3), np.uint8), 80, 40).shape == (36, 36, 3)

    def test_two_rows_of_pixels_are_one_of_characters(self) -> None:
        picture = np.array([[[1, 2, 3], [1, 2, 3]], [[4, 5, 6], [4, 5, 6]], [[7, 7, 7], [8, 8, 8]]], np.uint8)
        first, second = half_blocks(picture)
        assert first == "\x1b[38;2;1;2;3;48;2;4;5;6m▀▀\x1b[0m"
        assert second == "\x1b[38;2;7;7;7;48;2;0;0;0m▀\x1b[38;2;8;8;8;48;2;0;0;0m▀\x1b[0m"


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Any:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("SDL_AUDIODRIVER", "dummy")
    return pygame


class TestWindow:
    def test_keys_down_and_up(self, display: Any) -> None:
        from envcraft.cli.play.window import Window

        with Window("a game") as window:
            window.show(np.full((84, 84, 3), 90, np.uint8), ["one line"])
            assert display.display.get_surface().get_at((300, 100))[:3] == (90, 90, 90)
            for key in (display.K_LEFT, display.K_x, display.K_RETURN):
                display.event.post(display.event.Event(display.KEYDOWN, key=key))
            assert window.pressed(1.0) == ["left", "x", "enter"]
            display.event.post(display.event.Event(display.KEYUP, key=display.K_x))
            assert window.pressed(0.0) == []
            assert set(window.held()) == {"left", "x", "enter"}
            assert set(window.held()) == {"left", "enter"}
            display.event.post(display.event.Event(display.QUIT))
            assert window.pressed(1.0) == ["escape"]
        assert not display.display.get_init()

    def test_without_a_display_it_says_so_at_once(
        self, monkeypatch: pytest.MonkeyPatch, invoke: Any, good: Path
    ) -> None:
        for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr("sys.platform", "linux")
        # No sandbox starts, and nothing is judged, before the message.
        monkeypatch.setattr("envcraft.cli.commands.play.driver_named", None)
        result = invoke("play", good, "--window")
        assert result.exit_code == 2
        assert "there is no display for --window" in result.stderr

    def test_an_episode_in_a_window(self, display: Any, invoke: Any, good: Path) -> None:
        def person() -> None:
            while not display.display.get_init() or display.display.get_surface() is None:
                time.sleep(0.01)
            display.event.post(display.event.Event(display.KEYDOWN, key=display.K_RIGHT))
            time.sleep(2)
            display.event.post(display.event.Event(display.KEYDOWN, key=display.K_q))

        hand = threading.Thread(target=person)
        hand.start()
        result = invoke("play", good, "--window", "--sandbox", "process", "--fps", "60", "--seed", "3")
        hand.join()
        assert result.exit_code == 0, result.stderr
        assert "a person played seed 3: ended, success, return 1" in result.stdout

    def test_without_pygame_it_says_what_to_install(
        self, invoke: Any, good: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setitem(__import__("sys").modules, "pygame", None)
        result = invoke("play", good, "--window")
        assert result.exit_code == 2
        assert "pip install 'envcraft-rl[play]'" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nowhere.py",), "nowhere.py does not exist"),
        ((".",), "holds 2 environments; play one, such as ./other.py"),
        (("games",), "play its environments in the browser: `envcraft explore games`"),
        (("walk.py", "--contract", "arkade"), "did you mean arcade?"),
        (("walk.py",), "standard input and output must be a terminal"),
    ],
)
def test_a_usage_error_is_one_sentence(
    invoke: Any, good: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], words: str
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    good.with_name("other.py").write_text(good.read_text())
    if "games" in arguments:
        assert invoke("generate", "--family", "tetris", "--count", "2", "--corpus", "games").exit_code == 0
    result = invoke("play", *arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_what_cannot_be_loaded_is_no_pass(invoke: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("envcraft.cli.play.terminal.Terminal", Quitting)
    options = ("--contract", "gymnasium", "--terminal", "--sandbox", "process", "--output", "played.json")
    result = invoke("play", "NoSuchThing-v0", *options)
    assert result.exit_code == 3
    (report,) = json.loads((tmp_path / "played.json").read_text())["reports"]
    assert report["verdict"] == "error"
    assert [(check["check"], check["verdict"]) for check in report["checks"]] == [("play", "skip"), ("source", "error")]


def test_a_wrong_contract_is_a_usage_error(invoke: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "blind.py").write_text(BLIND)
    monkeypatch.setattr("envcraft.cli.play.terminal.Terminal", Quitting)
    result = invoke("play", "blind.py", "--terminal", "--sandbox", "process")
    assert result.exit_code == 2, result.stderr
    assert "name the contract that fits: --contract gymnasium" in result.stderr
    (tmp_path / "pyproject.toml").write_text('[tool.envcraft]\ncontract = "arcade-native"\n')
    result = invoke("play", "blind.py", "--terminal", "--sandbox", "process")
    assert result.exit_code == 2, result.stderr
    assert f"{tmp_path / 'pyproject.toml'}: [tool.envcraft] contract: the action space is Discrete(2)" in result.stderr


def test_where_render_fails_the_observations_are_shown(
    invoke: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "blind.py").write_text(BLIND)
    monkeypatch.setattr("envcraft.cli.play.terminal.Terminal", Quitting)
    options = ("--contract", "gymnasium", "--terminal", "--sandbox", "process", "--output", "played.json")
    result = invoke("play", "blind.py", *options)
    assert result.exit_code == 0, result.stderr
    assert "render() raises RuntimeError: no display: the observations are shown as they are" in result.stdout
    (report,) = json.loads((tmp_path / "played.json").read_text())["reports"]
    # The checks that judge many episodes have not judged this one.
    assert "determinism" not in [check["check"] for check in report["checks"]]
