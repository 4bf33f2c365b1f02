"""The family of falling-piece games: what is generated, and the rules of single variants, played."""

from __future__ import annotations

import ast
import dataclasses
import errno
import json
import sys
import types
from collections import Counter
from itertools import islice, pairwise
from pathlib import Path
from random import Random
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from click.testing import CliRunner
from envcraft_checks.imports import required_imports
from envcraft_tetris.axes import (
    board,
    clearing,
    controls,
    ending,
    entry,
    garbage,
    gravity,
    locking,
    look,
    pieces,
    rewards,
    rotation,
    supply,
)
from envcraft_tetris.family import TetrisFamily
from envcraft_tetris.values import VALUES
from envcraft_tetris.variant import Variant

from envcraft.cli.commands.generate import generate
from envcraft.cli.group import cli
from envcraft.corpus.store import Store
from envcraft.environments.families import Generated
from envcraft.errors import UsageError
from envcraft.similarity import behavioural, structural
from envcraft.similarity.perceptual import frame_hash

LEFT, RIGHT, DOWN, WAIT = [3, 0, 0], [4, 0, 0], [2, 0, 0], [0, 0, 0]
FIRST, SECOND = [0, 1, 0], [0, 0, 1]

SQUARE = ("##", "##")
BAR = ("....", "####", "....", "....")
#: Squares that fall a row every other step into a board of eight rows by six, and nothing else.
PLAIN = Variant(
    board=board.Board(8, 6, "rectangle", wrap=False),
    pieces=pieces.Pieces("custom pieces", (SQUARE,)),
    supply=supply.Supply("uniform", 0),
    entry=entry.Entry("middle"),
    controls=controls.Controls(up="", down="soft", first="cw", second="hard", press="every step", rest=0),
    rotation=rotation.Rotation("square", "none"),
    gravity=gravity.Gravity("constant", 2, 2),
    locking=locking.Locking("instant"),
    clearing=clearing.Clearing("rows"),
    garbage=garbage.Garbage("none"),
    ending=ending.Ending("lines", count=2),
    rewards=rewards.Rewards("linear", "none", line=1.0, prize=5.0, death=2.0),
    look=look.Look("neon", "flat", "plain", ghost=False, panel="left", hue=0.1, first=0.5),
)


@pytest.fixture(scope="module")
def hundred() -> list[Generated]:
    return list(TetrisFamily().generate(100, 0))


def load(source: str) -> Any:
    """The environment of a source that this repository's own templates made."""
    module = types.ModuleType("variant")
    exec(compile(source, "variant.py", "exec"), vars(module))
    (env_class,) = [found for found in vars(module).values() if isinstance(found, type) and issubclass(found, gym.Env)]
    return env_class()


def game(seed: int = 0, **changes: Any) -> Any:
    """A variant that differs from PLAIN in some axes, reset."""
    env = load(dataclasses.replace(PLAIN, **changes).write("Game"))
    env.reset(seed=seed)
    return env


def fill(env: Any, *rows: str) -> None:
    """Lay rows of blocks at the bottom: a dot is empty, a digit a colour."""
    for place, row in enumerate(reversed(rows), 1):
        env.board[-place] = [0 if mark == "." else int(mark) for mark in row]


def bottom(env: Any, rows: int) -> list[str]:
    return ["".join(str(block) if block else "." for block in row) for row in env.board[-rows:]]


def play(env: Any, *actions: list[int]) -> tuple[float, bool]:
    """The sum of the rewards, and whether the last step ended the game."""
    total, terminated = 0.0, False
    for action in actions:
        _, reward, terminated, _, _ = env.step(np.array(action))
        total += reward
    return total, terminated


class TestGenerated:
    def test_the_same_seed_gives_the_same_and_fewer_the_first_of_them(self, hundred: list[Generated]) -> None:
        assert list(TetrisFamily().generate(20, 0)) == hundred[:20]
        assert not {one.source for one in TetrisFamily().generate(20, 1)} & {one.source for one in hundred}

    def test_a_number_is_that_of_a_draw_and_the_unfit_have_none(self, hundred: list[Generated]) -> None:
        rng = Random(0)
        drawn = [(number, Variant.draw(rng)) for number in range(101)]
        assert [one.name for one in hundred] == [f"tetris_0_{number:04}" for number, one in drawn if one.fair]
        [unfit] = [one for _, one in drawn if not one.fair]
        assert (unfit.clearing.rule, unfit.board.shape) == ("sand", "stairs")

    def test_each_is_one_plain_readable_file(self, hundred: list[Generated]) -> None:
        for one in hundred[:40]:
            tree = ast.parse(one.source)
            assert set(required_imports(tree)) == {"__future__", "typing", "gymnasium", "numpy"}
            assert sum(isinstance(node, ast.ClassDef) for node in tree.body) == 1
            docstring = ast.get_docstring(tree) or ""
            assert all(part in docstring for part in ("Goal: ", "Controls: ", "Rewards: ")), one.name
            assert "<<" not in one.source
            assert max(map(len, one.source.splitlines())) <= 120
            assert 150 <= one.source.count("\n") <= 400
            json.dumps(one.metadata)

    def test_generated_code_has_no_unused_names(self, hundred: list[Generated]) -> None:
        """Rules that are off leave no code behind."""
        for one in hundred[:40]:
            tree = ast.parse(one.source)
            used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
            used |= {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
            made = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)} - {"reset", "step"}
            for node in tree.body:
                if isinstance(node, ast.Assign):
                    made |= {name.id for name in ast.walk(node) if isinstance(name, ast.Name) and name.id.isupper()}
            made -= {"__init__"}
            assert made <= used, (one.name, made - used)

    def test_no_two_are_alike(self, hundred: list[Generated]) -> None:
        assert len({structural.key(one.source.encode()) for one in hundred}) == 100
        found = [fingerprint(load(one.source)) for one in hundred]
        assert not list(behavioural.pairs(found))
        assert list(behavioural.pairs([*found, fingerprint(load(hundred[7].source))])) == [(7, 100)]

    def test_every_value_of_every_axis_comes(self) -> None:
        rng = Random(0)
        found = [Variant.draw(rng) for _ in range(1000)]

        def values(axis: str, field: str) -> set[Any]:
            return {getattr(getattr(variant, axis), field) for variant in found}

        assert values("pieces", "family") == set(pieces.SETS)
        assert values("board", "shape") == set(board.SHAPES)
        assert values("board", "wrap") == {False, True}
        assert values("supply", "order") == set(supply.ORDERS)
        assert values("supply", "preview") == {0, 1, 2, 3}
        assert values("entry", "place") == set(entry.PLACES)
        assert values("rotation", "system") == set(rotation.SYSTEMS)
        assert values("rotation", "kicks") == set(rotation.KICKS)
        assert values("gravity", "schedule") == set(gravity.SCHEDULES)
        assert values("locking", "kind") == set(locking.KINDS)
        assert values("clearing", "rule") == set(clearing.RULES)
        assert values("garbage", "rhythm") == set(garbage.RHYTHMS)
        assert values("garbage", "holes") == set(garbage.HOLES)
        assert values("ending", "goal") == set(ending.GOALS)
        assert values("rewards", "clears") == set(rewards.CLEARS)
        assert values("rewards", "extra") == set(rewards.EXTRAS)
        assert values("look", "style") == set(look.STYLES)
        assert values("look", "field") == set(look.FIELDS)
        assert values("look", "theme") == set(look.THEMES)
        assert values("controls", "press") == set(controls.PRESSES)
        assert values("controls", "drop") == {"button", "down", "none"}
        buttons = {tuple(sorted((variant.controls.first, variant.controls.second))) for variant in found}
        assert buttons == {tuple(sorted(pair)) for pair in controls.BUTTONS}

    def test_pieces_can_always_be_turned_and_no_function_is_on_two_controls(self) -> None:
        rng = Random(1)
        for _ in range(300):
            wanted = [function for function in Variant.draw(rng).controls.all if function]
            assert set(wanted) & set(controls.TURNING)
            assert len(wanted) == len(set(wanted))

    def test_random_play_ends_after_tens_to_hundreds_of_steps(self, hundred: list[Generated]) -> None:
        lengths = []
        for one in hundred[:30]:
            env = load(one.source)
            env.reset(seed=0)
            actions = np.random.default_rng(0).integers(0, (5, 2, 2), (1000, 3))
            lengths.append(next((step for step, action in enumerate(actions, 1) if env.step(action)[2]), 1000))
        assert 50 <= np.median(lengths) <= 300
        assert np.mean([20 <= length <= 600 for length in lengths]) >= 0.8


def fingerprint(env: Any) -> behavioural.Series:
    """As the audit makes it, of one episode of actions that are each held for a while."""
    frame, _ = env.reset(seed=0)
    frames, rewards, end = [frame_hash(frame)], [0.0], 0
    actions = np.repeat(np.random.default_rng(3).integers(0, (5, 2, 2), (64, 3)), 4, axis=0)
    for step, action in enumerate(actions, 1):
        frame, reward, terminated, _, _ = env.step(action)
        rewards[-1] += reward
        if step % behavioural.EVERY == 0:
            frames.append(frame_hash(frame))
            rewards.append(0.0)
        if terminated:
            end = 1
            break
    return behavioural.Series(b"script", end, step, np.array(frames, "<u8"), np.round(rewards, 4).astype("<f4"))


class TestWhere:
    def test_it_selects_from_the_same_variants(self, hundred: list[Generated]) -> None:
        chosen = [one for one in hundred if one.metadata["axes"]["board"]["columns"] == 8][:5]
        assert len(chosen) == 5
        assert list(TetrisFamily().where({"board.columns": "8"}).generate(5, 0)) == chosen

    def test_values_of_several_axes(self) -> None:
        axes = {"board.wrap": "true", "look.theme": "Mono", "clearing.rule": "rows"}
        for one in TetrisFamily().where(axes).generate(4, 0):
            found = one.metadata["axes"]
            assert (found["board"]["wrap"], found["look"]["theme"], found["clearing"]["rule"]) == (True, "mono", "rows")

    @pytest.mark.parametrize(
        ("axes", "words"),
        [
            ({"board.rows": "99"}, "--where board.rows=99: board.rows is from 11 to 20"),
            ({"board.rows": "many"}, "--where board.rows=many: board.rows is from 11 to 20"),
            ({"board.wrap": "maybe"}, "board.wrap is false or true"),
            ({"controls.up": "up"}, "controls.up is cw, ccw or hold"),
            ({"rewards.line": "3"}, "rewards.line is 0.5, 1.0 or 2.0"),
            ({"look.hue": "1.1"}, "look.hue is from 0 to 1, in steps of 0.001"),
        ],
    )
    def test_a_value_that_the_axis_cannot_have_is_an_error_at_once(self, axes: dict[str, str], words: str) -> None:
        with pytest.raises(UsageError) as caught:
            TetrisFamily().where(axes)
        assert str(caught.value).endswith(words)

    def test_a_number_may_be_written_in_any_way(self) -> None:
        axes = {"rewards.line": "2", "board.columns": "8.0"}
        [one] = TetrisFamily().where(axes).generate(1, 0)
        assert (one.metadata["axes"]["rewards"]["line"], one.metadata["axes"]["board"]["columns"]) == (2.0, 8)

    def test_values_that_never_come_together_are_an_error(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("envcraft_tetris.family._PATIENCE", 50)
        axes = {"board.columns": "6", "clearing.rule": "sand"}
        with pytest.raises(UsageError, match=r"none of 50 draws has board\.columns=6 and clearing\.rule=sand; ask for"):
            next(TetrisFamily().where(axes).generate(1, 0))
        with pytest.raises(UsageError, match=r"none of 50 draws has clearing\.group=5; it is rare; try another --seed"):
            next(TetrisFamily().where({"clearing.group": "5"}).generate(1, 0))

    def test_the_values_of_an_axis_are_those_that_are_drawn(self) -> None:
        rng, drawn = Random(0), {axis: set[Any]() for axis in VALUES}
        for _ in range(1_500):
            axes = Variant.draw(rng).axes()
            found = {
                f"{group}.{name}": value
                for group, values in axes.items()
                for name, value in values.items()
                if not isinstance(value, list | tuple)
            }
            assert list(found) == list(VALUES)
            for axis, value in found.items():
                drawn[axis].add(value)
        for axis, seen in drawn.items():
            assert seen <= set(VALUES[axis]), axis
            # Some numbers are rare.
            missing = set(VALUES[axis]) - seen
            assert not any(isinstance(value, str | bool) for value in missing), axis
            assert len(VALUES[axis]) > 1000 or len(missing) <= len(VALUES[axis]) // 4, axis


class TestMoves:
    def test_a_piece_falls_and_stays_where_it_can_fall_no_further(self) -> None:
        env = game()
        play(env, *[WAIT] * 12)
        assert (env.row, bottom(env, 1)) == (6, ["......"])
        play(env, WAIT, WAIT)
        assert bottom(env, 3) == ["......", "..11..", "..11.."]
        assert env.row == 0

    def test_walls_stop_it_and_a_round_board_does_not(self) -> None:
        stopped = game()
        play(stopped, *[LEFT] * 5)
        assert sorted({x for _, x in stopped._cells()}) == [0, 1]
        rounded = game(board=dataclasses.replace(PLAIN.board, wrap=True))
        play(rounded, *[LEFT] * 3)
        assert sorted({x for _, x in rounded._cells()}) == [0, 5]

    @pytest.mark.parametrize(("kicks", "turn"), [("none", 1), ("beside", 1), ("far", 2)])
    def test_kicks_let_a_piece_turn_at_a_wall(self, kicks: str, turn: int) -> None:
        env = game(pieces=pieces.Pieces("custom pieces", (BAR,)), rotation=rotation.Rotation("square", kicks))
        play(env, FIRST, *[LEFT] * 6)
        assert {x for _, x in env._cells()} == {0}
        # The bar stands in the third column of its square, two to the left of what it needs.
        play(env, FIRST)
        assert env.turn == turn

    def test_a_button_acts_at_every_step_or_once(self) -> None:
        bar = pieces.Pieces("custom pieces", (BAR,))
        held = game(pieces=bar)
        play(held, FIRST, FIRST, FIRST)
        assert held.turn == 3
        once = game(pieces=bar, controls=dataclasses.replace(PLAIN.controls, press="once"))
        play(once, FIRST, FIRST, WAIT, FIRST)
        assert once.turn == 2

    def test_a_drop_has_to_rest(self) -> None:
        env = game(controls=dataclasses.replace(PLAIN.controls, rest=3))
        play(env, SECOND, SECOND, SECOND)
        assert bottom(env, 4) == ["......", "......", "..11..", "..11.."]
        play(env, SECOND)
        assert bottom(env, 4) == ["..11..", "..11..", "..11..", "..11.."]

    def test_hold_puts_a_piece_aside_once_for_each(self) -> None:
        two = pieces.Pieces("custom pieces", (SQUARE, BAR))
        holds = dataclasses.replace(PLAIN.controls, first="hold", up="cw")
        env = game(pieces=two, controls=holds, supply=supply.Supply("bag", 1))
        aside, following = env.kind, env.queue[0]
        play(env, FIRST)
        assert (env.held, env.kind) == (aside, following)
        play(env, FIRST)
        assert (env.held, env.kind) == (aside, following)
        play(env, SECOND, FIRST)
        assert env.kind == aside

    def test_a_piece_can_be_moved_on_the_ground_for_the_delay(self) -> None:
        later = game(locking=locking.Locking("delay", 3))
        while later._fits(later.turn, later.row + 1, later.column):
            play(later, DOWN)
        later.grounded = 0
        play(later, LEFT, LEFT)
        assert sorted({x for _, x in later._cells()}) == [0, 1]
        play(later, WAIT, WAIT)
        assert bottom(later, 1) == ["11...."]


class TestSupply:
    @pytest.mark.parametrize(("order", "copies"), [("bag", 1), ("double bag", 2)])
    def test_a_bag_is_fair(self, order: str, copies: int) -> None:
        env = game(pieces=pieces.Pieces("custom pieces", (SQUARE, BAR, ("#",))), supply=supply.Supply(order, 0))
        env.bag = []
        for _ in range(5):
            assert Counter(env._draw_kind() for _ in range(3 * copies)) == {0: copies, 1: copies, 2: copies}

    def test_weights_and_history_are_kept(self) -> None:
        three = pieces.Pieces("custom pieces", (SQUARE, BAR, ("#",)))
        env = game(pieces=three, supply=supply.Supply("weighted", 0, weights=(1, 0, 3)))
        drawn = Counter(env._draw_kind() for _ in range(400))
        assert drawn[1] == 0
        assert 240 <= drawn[2] <= 350
        env = game(pieces=three, supply=supply.Supply("history", 0, memory=1, tries=6))
        kinds = [env._draw_kind() for _ in range(200)]
        assert sum(one == two for one, two in pairwise(kinds)) <= 5


class TestClearing:
    def test_a_full_row_is_cleared_and_paid(self) -> None:
        env = game()
        fill(env, "1.....", "11..11")
        reward, ended = play(env, SECOND)
        assert bottom(env, 3) == ["......", "......", "1.11.."]
        assert (reward, ended, env.cleared) == (1.0, False, 1)

    def test_the_goal_wins_and_further_steps_change_nothing(self) -> None:
        env = game()
        fill(env, "11..11", "11..11")
        assert play(env, SECOND) == (7.0, True)
        assert env._info()["is_success"] is True
        assert play(env, SECOND, LEFT) == (0.0, True)

    def test_what_is_above_falls_by_the_row_or_as_far_as_it_can(self) -> None:
        rows = ("33....", "3.....", "11..11", ".....1")
        left = {}
        for rule in ("rows", "cascade", "sticky", "sand"):
            env = game(clearing=clearing.Clearing(rule))
            fill(env, *rows)
            play(env, SECOND)
            left[rule] = bottom(env, 3)
        assert left["rows"] == ["33....", "3.....", "..11.1"]
        assert left["sticky"] == ["......", "33....", "3.11.1"]
        assert left["cascade"] == left["sand"] == ["......", "3.....", "3311.1"]

    def test_a_piece_crumbles_into_sand(self) -> None:
        env = game(clearing=clearing.Clearing("sand"))
        fill(env, "..2...")
        play(env, SECOND)
        assert bottom(env, 3) == ["..1...", "..11..", "..21.."]

    def test_groups_of_a_colour_are_cleared(self) -> None:
        env = game(clearing=clearing.Clearing("colour", colours=1, group=6))
        fill(env, "22....", "2211..")
        play(env, SECOND)
        assert bottom(env, 2) == ["22....", "22...."]
        assert env.cleared == 1

    def test_what_moves_into_a_wall_is_crushed(self) -> None:
        walls = ("......",) * 6 + ("#.....", "......")
        env = game(board=board.Board(8, 6, "stairs", wrap=False, walls=walls))
        wall = env.board[6][0]
        fill(env, "1.....", f"{wall}.....", "11..11")
        play(env, SECOND)
        assert bottom(env, 3) == ["......", f"{wall}.....", "..11.."]


class TestGarbage:
    def test_it_rises_with_the_steps(self) -> None:
        env = game(garbage=garbage.Garbage("steps", every=5))
        play(env, *[WAIT] * 4)
        assert bottom(env, 1) == ["......"]
        play(env, WAIT)
        assert [row.count(".") for row in bottom(env, 2)] == [6, 1]
        play(env, *[WAIT] * 5)
        assert [row.count(".") for row in bottom(env, 3)] == [6, 1, 1]

    @pytest.mark.parametrize(("rhythm", "rows"), [("pieces", 1), ("idle pieces", 0)])
    def test_it_rises_with_the_pieces_or_with_those_that_clear_nothing(self, rhythm: str, rows: int) -> None:
        env = game(garbage=garbage.Garbage(rhythm, every=2), ending=ending.Ending("lines", count=9))
        play(env, SECOND)
        fill(env, "11..11", "11..11")
        play(env, SECOND)
        assert sum(row.count("2") == 5 for row in bottom(env, 4)) == rows

    def test_a_piece_rides_on_it(self) -> None:
        env = game(garbage=garbage.Garbage("steps", every=13), locking=locking.Locking("delay", 9))
        play(env, *[WAIT] * 12)
        assert env.row == 6
        play(env, WAIT)
        assert env.row == 5
        assert env._fits(env.turn, env.row, env.column)

    def test_digging_it_up_wins(self) -> None:
        env = game(garbage=garbage.Garbage("none", start=3), ending=ending.Ending("dig"))
        assert [row.count(".") for row in bottom(env, 4)] == [6, 1, 1, 1]
        fill(env, "......", "11..11", "22..22")
        assert play(env, SECOND) == (7.0, True)


class TestEndings:
    def test_no_room_loses(self) -> None:
        env = game()
        reward, ended = play(env, *[SECOND] * 4)
        assert (reward, ended) == (-2.0, True)
        assert env._info()["is_success"] is False

    def test_blocks_above_the_line_lose(self) -> None:
        env = game(ending=ending.Ending("lines", count=2, ceiling=3))
        assert play(env, SECOND, SECOND)[1] is False
        assert play(env, SECOND)[1] is True

    @pytest.mark.parametrize(("goal", "won"), [("clock", False), ("survive", True)])
    def test_time_runs_out(self, goal: str, won: bool) -> None:
        env = game(ending=ending.Ending(goal, count=2, steps=10))
        assert play(env, *[WAIT] * 9)[1] is False
        assert play(env, WAIT)[1] is True
        assert env._info()["is_success"] is won

    def test_the_limit_truncates(self) -> None:
        env = game(gravity=gravity.Gravity("constant", 2000, 2000))
        play(env, *[WAIT] * 999)
        _, _, terminated, truncated, _ = env.step(np.array(WAIT))
        assert (terminated, truncated) == (False, True)


class TestCommand:
    def test_into_a_corpus_and_again(self, tmp_path: Path) -> None:
        arguments = ["--family", "tetris", "--count", "3", "--corpus", str(tmp_path / "corpus")]
        first = CliRunner().invoke(generate, arguments)
        assert first.exit_code == 0, first.output
        assert first.output.startswith("wrote 3, kept 0 that exist")
        assert CliRunner().invoke(generate, arguments).output.startswith("wrote 0, kept 3 that exist")
        with Store(tmp_path / "corpus") as store:
            rows = store.db.execute("SELECT name, origin FROM environments ORDER BY name").fetchall()
        assert [name for name, _ in rows] == [f"tetris_0_000{number}.py" for number in range(3)]
        assert json.loads(rows[0][1])["family"] == "tetris"

    def test_into_a_folder_without_overwriting(self, tmp_path: Path) -> None:
        arguments = ["--family", "tetris", "--count", "3", "--output", str(tmp_path)]
        assert CliRunner().invoke(generate, arguments).exit_code == 0
        sources = [one.source for one in islice(TetrisFamily().generate(3, 0), 3)]
        assert [path.read_text() for path in sorted(tmp_path.iterdir())] == sources
        (tmp_path / "tetris_0_0001.py").write_text("mine")
        (tmp_path / "tetris_0_0002.py").unlink()
        result = CliRunner().invoke(generate, arguments)
        assert "has another source for tetris_0_0001.py" in str(result.exception)
        assert not (tmp_path / "tetris_0_0002.py").exists()

    @pytest.mark.parametrize("option", ["--corpus", "--output"])
    def test_where_nothing_can_be_written_is_a_usage_error(self, tmp_path: Path, option: str) -> None:
        (tmp_path / "file").write_text("")
        arguments = ["--family", "tetris", option, str(tmp_path / "file" / "games")]
        error = CliRunner().invoke(generate, arguments).exception
        assert isinstance(error, UsageError)
        assert str(error) == f"{tmp_path / 'file'} is a file; name a folder"

    @pytest.mark.parametrize("ending", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left on device")])
    def test_what_ends_it_leaves_no_file(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: BaseException
    ) -> None:
        write = Path.write_bytes

        def written(path: Path, data: bytes) -> int:
            if path.name == "tetris_0_0001.py":
                write(path, data[:100])
                raise ending
            return write(path, data)

        monkeypatch.setattr(Path, "write_bytes", written)
        result = CliRunner().invoke(cli, ["generate", "--family", "tetris", "--count", "3", "--output", str(tmp_path)])
        told = {130: "nothing was written\ninterrupted\n", 3: f"Error: {tmp_path} cannot be written: No space left"}
        assert result.stderr.startswith(told[result.exit_code])
        assert not [*tmp_path.iterdir()]

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--family", "tetri", "--output", "x"], "did you mean tetris"),
            (["--output", "x"], "choose a --family"),
            (["--family", "tetris"], "either --corpus DIR or --output DIR"),
            (["--family", "tetris", "--where", "board.row=9", "--output", "x"], "did you mean board.rows"),
            (["--family", "tetris", "--where", "board.rows", "--output", "x"], "is not AXIS=VALUE"),
            (
                ["--family", "tetris", "--where", "board.rows=9", "--where", "board.rows=8", "--output", "x"],
                "gives board.rows twice: 9 and 8",
            ),
            (["--family", "snake", "--where", "board.rows=9", "--output", "x"], "snake has no axis that --where can"),
        ],
    )
    def test_a_usage_error_is_named(self, arguments: list[str], words: str) -> None:
        assert words in str(CliRunner().invoke(generate, arguments).exception)


def test_a_generated_file_needs_no_part_of_this_repository(hundred: list[Generated]) -> None:
    names = {name.partition(".")[0] for one in hundred for name in required_imports(ast.parse(one.source))}
    assert names - set(sys.stdlib_module_names) == {"gymnasium", "numpy"}
