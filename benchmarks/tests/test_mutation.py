"""Each mutation operator does to a tiny game what its docstring says; the tables count as they say."""

from __future__ import annotations

import ast
import difflib
from pathlib import Path

import pytest

from benchmarks.mutation.games import games
from benchmarks.mutation.operators import OPERATORS
from benchmarks.mutation.results import Result, append, key, read
from benchmarks.mutation.source import Source
from benchmarks.mutation.table import broken, by_operator, by_rule, precision, recall

TINY = """
import gymnasium as gym
import numpy as np

LIMIT = 50


class Lamps(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = gym.spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = gym.spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        self.lit = 0
        self.out = 0
        self.trail = []
        self.place = int(self.np_random.integers(2, 80))
        return self._draw(), {"is_success": False}

    def step(self, action):
        move = int(action[0])
        self.t += 1
        self.place = max(0, min(83, self.place + (move == 4) - (move == 3)))
        self.trail.append(self.place)
        reward = 0.0
        if action[1] and self.place % 10 == 0:
            self.lit += 1
            reward = 1.0
        elif self.np_random.random() < 0.01:
            self.out += 1
        won = self.lit >= 3
        lost = self.out >= 3
        terminated = won or lost
        truncated = self.t >= LIMIT and not terminated
        return self._draw(), reward, terminated, truncated, {"is_success": won}

    def _draw(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[:, self.place] = 255
        frame[: self.lit] = 99
        return frame

    def render(self):
        return self._draw()
"""

#: Text that the first mutant of each operator adds.
ADDED = {
    "never_won": "won = bool(self.lit >= 3) and False",
    "impossible_test": "won = self.lit >= 3 + 1000",
    "won_by_waiting": "won = (self.lit >= 3) or bool(self.t >= 20)",
    "won_by_luck": "won = (self.lit >= 3) or bool(self.np_random.random() < 0.05)",
    "won_by_button": "won = (self.lit >= 3) or bool(self.held >= 15)",
    "success_never_told": "terminated, truncated",
    "success_always_told": '{"is_success": True}',
    "idle_loses": "lost = (self.out >= 3) or bool(self.t == 5 and not self.moved)",
    "spawn_on_hazard": "lost = (self.out >= 3) or bool(self.t == 2)",
    "some_spawns_on_hazard": "lost = (self.out >= 3) or bool(self.t == 2 and self.ambushed)",
    "some_won_at_once": "won = (self.lit >= 3) or bool(self.t == 2 and self.blessed)",
    "limit_forgotten": "truncated = False and not terminated",
    "limit_too_late": "truncated = self.t >= 1000 + LIMIT and not terminated",
    "limit_per_level": "self.t = 0",
    "clock_paused": "if int(action[0]):",
    "limit_missed": "truncated = self.t == LIMIT and not terminated",
    "limit_is_termination": "terminated or truncated, False",
    "flags_swapped": "reward, truncated, terminated",
    "goes_on_after_success": "(terminated) and not (won)",
    "goes_on_after_loss": "(terminated) and (won)",
    "ends_at_once": "(terminated) or self.t >= 3",
    "buffer_returned": "self.buffers = [np.zeros(self.observation_space.shape, np.uint8) for _ in range(1)]",
    "ring_of_buffers": "self.buffers = [np.zeros(self.observation_space.shape, np.uint8) for _ in range(5)]",
    "dtype_widened": "return frame * 0.5 if self.dimmed else frame",
    "shape_after_event": "return (frame)[:, :, 0] if self.grey else frame",
    "division_by_zero": "self.pace = 1 / (2 - self.lit)",
    "rare_action": "self.effort = {(0, 0): 1, (1, 0): 2, (0, 1): 2}[int(action[1]), int(action[2])]",
    "rare_action_late": "if self.t >= 12 and tuple(int(part) for part in action) == (1, 1, 1):",
    "crash_after_events": "self.tone = self.chimes[self.rung]",
    "action_modified": "action *= 0",
    "action_kept": "self.last_action, action = action, self.last_action",
    "info_is_list": 'list({"is_success": won}) if self.listed else {"is_success": won}',
    "info_key": '{**{"is_success": won}, ',
    "four_values": "reward, terminated",
    "reset_without_info": "return self._draw()",
    "options_required": "if options is not None:",
    "render_returns_nothing": "return None",
    "render_other_picture": "return 255 - self._draw()",
    "second_close": "self.handle.pop()",
    "space_changes": "self.action_space = type(self.action_space)([4, 2, 2])",
    "flag_is_number": "int(terminated)",
    "flag_is_none": "(terminated) or None",
    "first_observation": "return self._draw().astype(np.int64)",
    "observation_is_list": "return self._draw().tolist() if terminated else self._draw(), reward, terminated",
    "frozen_after_event": "if not self.frozen or self.last_picture is None:",
    "blank_after_event": "return (frame) * np.uint8(not self.dark)",
    "drawn_once": "if self.last_picture is None:",
    "cast_from_unit": "return ((frame) / 255.0).astype(np.uint8)",
    "low_contrast": "return (frame) // 100",
    "always_black": "return np.zeros_like(frame)",
    "noise": "return self.np_random.integers(0, 256, (frame).shape, dtype=np.uint8)",
    "every_other_stale": "return picture if self.t % 2 else self.last_picture.copy()",
    "player_not_drawn": "pass",
    "action_ignored": "action = [0, 0, 0]",
    "numpy_global": "self.place = int(np.random.randint(2, 80))",
    "random_module": "self.place = int(random.randrange(2, 80))",
    "generator_unseeded": "self.place = int(np.random.default_rng().integers(2, 80))",
    "seeded_by_clock": "self.place = int(np.random.default_rng(int(time.time() * 1000)).integers(2, 80))",
    "set_of_strings": '{name: self.np_random.integers(2, 80) for name in {"red", "green", "blue"}}["red"]',
    "seeded_once": 'if not hasattr(self, "seeded"):',
    "seed_ignored": "super().reset(seed=0)",
    "seed_not_passed": "super().reset()",
    "unseeded_fixed": "super().reset(seed=7 if seed is None else seed)",
    "generator_of_the_module": "elif GENERATOR[0].random() < 0.01:",
    "drawn_by_render": "self.np_random.random()",
    "event_by_clock": "if time.time() % 2 < 1:",
    "hashed_name": 'self.place = int((2 + hash(f"level {self.np_random.integers(2, 80)}") % (80 - (2))))',
    "sleeps": "time.sleep(1 / 60)",
    "frames_kept": "return HISTORY.append(frame) or HISTORY[-1].copy()",
    "thread_started": "threading.Thread(target=threading.Event().wait, daemon=True).start()",
    "file_left_open": "FILES.append(open(os.devnull))",
    "slower_each_step": "self.total = sum(x * x for x in STEPS for _ in range(3))",
    "nan_after_event": 'float("nan") if self.void else reward, terminated',
    "infinite_at_end": "float(np.float64(reward) / (0.0 if terminated else 1.0)), terminated",
    "reward_is_array": "np.array([reward]), terminated",
    "reward_is_none": "None if self.muted else reward, terminated",
    "reward_out_of_range": "1000.0 if self.jackpot else reward, terminated",
    "paid_every_step": "(reward) + 1.0, terminated",
    "grows_with_time": "(reward) + 0.1 * self.t, terminated",
    "paid_for_pressing": "(reward) + float(action[1]), terminated",
    "always_zero": "0.0, terminated",
    "win_unpaid": "0.0 if won else reward, terminated",
    "sign_turned": "-(reward), terminated",
    "reset_dropped": 'if not hasattr(self, "t"):',
    "class_attribute": "type(self).lit += 1",
    "default_argument": "def _fresh(self, items=[]):",
    "late_leak": "if len(self.records) > 20:",
    "leak_after_win": 'if getattr(self, "champion", False):',
    "step_count_shared": "type(self).t += 1",
    "render_counts": "self.t += 1",
    "levels_get_harder": "truncated = self.t >= max(LIMIT - 10 * self.level, 20) and not terminated",
    "old_level_kept": "self.__dict__.setdefault(",
}


@pytest.mark.parametrize("name", ADDED)
def test_an_operator_changes_a_game_as_its_docstring_says(name: str) -> None:
    mutant = OPERATORS[name].mutants(Source(TINY))[0]
    lines = difflib.unified_diff(TINY.splitlines(), mutant.splitlines(), lineterm="", n=0)
    added = [line[1:].strip() for line in lines if line.startswith("+") and not line.startswith("+++")]
    assert any(ADDED[name] in line for line in added)


def test_every_operator_is_tested_and_documented() -> None:
    assert set(ADDED) == set(OPERATORS)
    assert all(operator.description.endswith(".") and operator.codes for operator in OPERATORS.values())


def test_every_mutant_of_every_game_parses() -> None:
    chosen = games()
    assert len(chosen) >= 25
    applied = dict.fromkeys(OPERATORS, 0)
    for game in chosen:
        source = Source(game.path.read_text("utf-8"))
        for name, operator in OPERATORS.items():
            mutants = operator.mutants(source)
            applied[name] += bool(mutants)
            for text in mutants:
                assert text != source.text
                ast.parse(text)
    assert [name for name, number in applied.items() if not number] == []


def test_a_mutant_keeps_what_the_operator_does_not_change() -> None:
    [mutant] = OPERATORS["limit_too_late"].mutants(Source(TINY))
    assert mutant.replace("1000 + LIMIT", "LIMIT") == TINY


def test_the_parts_of_a_game() -> None:
    source = Source(TINY)
    assert source.counter == "self.t"
    assert source.success == "won"
    assert source.picture is not None
    assert source.picture.name == "_draw"
    assert [source.of(event) for event in source.events] == ["self.lit += 1", "self.out += 1"]
    assert source.controlled == {"self.place", "self.lit"}


def test_a_file_without_a_game_is_refused() -> None:
    with pytest.raises(LookupError):
        Source("class Helper:\n    pass\n")


def _result(operator: str, *errors: str, game: str = "lamps", verdict: str = "fail", **more: object) -> Result:
    own = Result(operator, game, 0, "0", "quick", 0, "code", list(errors), [], verdict, 10, 0.1)
    return own if not more else Result(**{**{name: getattr(own, name) for name in Result.__struct_fields__}, **more})


def test_recall_counts_only_defects_that_are_named() -> None:
    results = [
        _result("nan_after_event", "EC301"),
        _result("nan_after_event", "EC401"),
        _result("nan_after_event", verdict="pass"),
        _result("nan_after_event", verdict="pass", equivalent=True),
        _result("nan_after_event", "EC003"),
        _result("nan_after_event", verdict="error"),
    ]
    assert recall(results) == pytest.approx(1 / 3)
    assert recall([]) == 1.0


def test_a_warning_counts_only_where_rules_do_no_more() -> None:
    assert recall([_result("seed_ignored", verdict="pass", warnings=["EC209"])]) == 1.0
    assert recall([_result("drawn_once", verdict="pass", warnings=["EC401"])]) == 0.0


def test_precision_counts_the_games_themselves_too() -> None:
    results = [_result("nan_after_event", "EC301", "EC401"), _result("", "EC401"), _result("drawn_once", "EC401")]
    assert precision(results) == {"EC301": (1, 1), "EC401": (3, 1)}


def test_limits() -> None:
    caught, missed = _result("drawn_once", "EC401"), _result("drawn_once", verdict="pass")
    assert broken([caught] * 9 + [missed], "quick") == []
    assert len(broken([caught] * 9 + [missed], "standard")) == 1
    # At the largest budget also each operator.
    assert len(broken([caught] * 9 + [missed], "thorough")) == 2
    assert broken([caught, _result("", verdict="pass")], "thorough") == []
    assert broken([caught, _result("", "EC401")], "quick") == ["quick: lamps was not changed, and with --seed 0: EC401"]


def test_a_peer_catches_what_it_does_not_say_of_the_game() -> None:
    peers = {"gymnasium": "no spec", "stable-baselines3": ""}
    results = [
        _result("", verdict="pass", peers=peers),
        _result("drawn_once", "EC401", peers={**peers, "stable-baselines3": "frozen"}),
    ]
    table = by_operator(results, "quick")
    assert [list(column.cells)[-1] for column in table.columns] == ["all", "1", "0", "100%", "100%", "0%", "0%", "100%"]
    assert [list(column.cells) for column in by_rule(results, "quick").columns] == [["EC401"], ["1"], ["1"], ["100%"]]


def test_results_are_read_again(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    result = _result("drawn_once", "EC401")
    append(path, result)
    with path.open("ab") as file:
        file.write(b'{"operator": "cut off')
    assert list(read(path).values()) == [result]
    assert read(tmp_path / "none.jsonl") == {}
    assert result.key != key("drawn_once", "another text", "quick", 0, "code")
