"""Which blocks are cleared, and how the remaining blocks fall."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.board import Board
from envcraft_tetris.axes.pieces import Pieces

RULES = ("rows", "cascade", "sticky", "sand", "colour")
#: The minimum group size by number of colours, in pieces. With fewer colours, larger groups form by chance.
_GROUPS = {3: 3.0, 4: 2.3, 5: 2.0}
_TEXTS = {
    "rows": "A full row is cleared, and all above comes down by one row.",
    "cascade": "A full row is cleared; then every block falls as far as it can, which may fill further rows.",
    "sticky": "A full row is cleared; then blocks that touch fall together, and may fill further rows.",
    "sand": "A piece that stays crumbles: its blocks fall one by one. A full row is cleared, and the rest falls again.",
}


@dataclass(frozen=True)
class Clearing:
    """The rule. Under `colour`, groups of at least `group` blocks with one of `colours` colours are cleared."""

    rule: str
    colours: int = 0
    group: int = 0

    @classmethod
    def draw(cls, rng: Random, pieces: Pieces, board: Board) -> Clearing:
        rule = rng.choices(RULES, (5, 2, 2, 3, 2))[0]
        if rule == "sand" and (board.columns < 8 or board.rows > 15 or board.wrap):
            # On a narrow board, sand fills rows without any play.
            return cls("cascade")
        if rule == "colour" and len(pieces.art) < 3:
            return cls("rows")
        if rule == "colour":
            colours = rng.randint(3, min(5, len(pieces.art)))
            return cls(rule, colours, round(_GROUPS[colours] * pieces.cells) + rng.randint(0, 2))
        return cls(rule)

    @property
    def easy(self) -> bool:
        """Whether random play clears something occasionally."""
        return self.rule in ("sand", "colour")

    @property
    def units(self) -> str:
        """The plural noun for what is cleared."""
        return "groups" if self.rule == "colour" else "lines"

    def write(self, code: SourceBuilder, board: Board) -> None:
        if self.rule == "colour":
            self._write_colour(code, board)
        else:
            code.add("story", _TEXTS[self.rule])
            code.add("colour", "self.kind + 1")
            self._write_rows(code, board)
        code.add(
            "methods",
            """
            def _lock(self) -> None:
                \"\"\"Leave the piece where it is, clear what can be cleared and let the next one in.\"\"\"
                for y, x in self._cells():
                    <<put>>
                cleared = self._clear()
                self.cleared += cleared
                <<pay>>
                <<locked>>
                <<goal>>
                if not <<over>>:
                    self._enter()
                self._paint()
            """,
        )
        if self.rule in ("cascade", "sand", "colour"):
            self._write_settling(code, bool(board.walls))
        elif self.rule == "sticky":
            self._write_sticky(code)
        if self.rule in ("sticky", "colour"):
            self._write_groups(code, board)

    def _write_rows(self, code: SourceBuilder, board: Board) -> None:
        rows = "_clear" if self.rule == "rows" else "_clear_rows"
        if self.rule != "rows":
            code.add(
                "methods",
                """
                def _clear(self) -> int:
                    <<crumble>>
                    cleared = 0
                    while full := self._clear_rows():
                        cleared += full
                        self._settle()
                    return cleared
                """,
            )
            if self.rule == "sand":
                code.add("crumble", "self._settle()")
        if board.walls:
            code.add(
                "methods",
                f"""
                def {rows}(self) -> int:
                    full = [y for y, row in enumerate(self.board) if all(row)]
                    for y in full:
                        for row in range(y, -1, -1):
                            above = self.board[row - 1] if row else [EMPTY] * COLUMNS
                            self.board[row] = [
                                WALL if here == WALL else EMPTY if block == WALL else block
                                for here, block in zip(self.board[row], above, strict=True)
                            ]
                    return len(full)
                """,
            )
            return
        code.add(
            "methods",
            f"""
            def {rows}(self) -> int:
                kept = [row for row in self.board if not all(row)]
                full = ROWS - len(kept)
                self.board = [[EMPTY] * COLUMNS for _ in range(full)] + kept
                return full
            """,
        )

    def _write_colour(self, code: SourceBuilder, board: Board) -> None:
        code.add(
            "story",
            f"Pieces have {self.colours} colours. {self.group} blocks of one colour or more that touch side by side "
            "are cleared; then every block falls as far as it can, and may make further groups. Full rows stay.",
        )
        code.add("constants", f"COLOURS, GROUP = {self.colours}, {self.group}")
        code.add("colour", "self.kind % COLOURS + 1")
        code.add(
            "methods",
            """
            def _clear(self) -> int:
                cleared = 0
                while groups := [group for group in self._groups() if len(group) >= GROUP]:
                    cleared += len(groups)
                    for y, x in set().union(*groups):
                        self.board[y][x] = EMPTY
                    self._settle()
                return cleared
            """,
        )

    def _write_settling(self, code: SourceBuilder, walls: bool) -> None:
        code.add("block", *(("if block == WALL:", "    floor = y - 1", "elif block:") if walls else ("if block:",)))
        code.add(
            "methods",
            """
            def _settle(self) -> None:
                \"\"\"Let every block fall as far as it can.\"\"\"
                for x in range(COLUMNS):
                    floor = ROWS - 1
                    for y in range(ROWS - 1, -1, -1):
                        block = self.board[y][x]
                        <<block>>
                            self.board[y][x] = EMPTY
                            self.board[floor][x] = block
                            floor -= 1
            """,
        )

    def _write_sticky(self, code: SourceBuilder) -> None:
        code.add(
            "methods",
            """
            def _settle(self) -> None:
                \"\"\"Let blocks that touch fall together, row by row, until nothing moves.\"\"\"
                while loose := next((group for group in self._groups() if self._hangs(group)), None):
                    blocks = [(y, x, self.board[y][x]) for y, x in loose]
                    for y, x, _ in blocks:
                        self.board[y][x] = EMPTY
                    for y, x, block in blocks:
                        self.board[y + 1][x] = block
            """,
            """
            def _hangs(self, group: set[tuple[int, int]]) -> bool:
                return all((y + 1, x) in group or (y + 1 < ROWS and not self.board[y + 1][x]) for y, x in group)
            """,
        )

    def _write_groups(self, code: SourceBuilder, board: Board) -> None:
        alike = "of one colour " if self.rule == "colour" else ""
        code.add("kept", "not in (EMPTY, WALL)" if board.walls else "!= EMPTY")
        code.add("joins", "blocks.get(near) == colour" if self.rule == "colour" else "near in blocks")
        code.add("start", "start, colour" if self.rule == "colour" else "start, _")
        wrap = board.wrap
        code.add("sides", "(y, (x + 1) % COLUMNS), (y, (x - 1) % COLUMNS)" if wrap else "(y, x + 1), (y, x - 1)")
        code.add(
            "methods",
            f"""
            def _groups(self) -> list[set[tuple[int, int]]]:
                \"\"\"The groups of blocks {alike}that touch side by side, each as its cells.\"\"\"
                rows = enumerate(self.board)
                blocks = {{(y, x): block for y, row in rows for x, block in enumerate(row) if block <<kept>>}}
                groups = []
                while blocks:
                    <<start>> = blocks.popitem()
                    group, waiting = {{start}}, [start]
                    while waiting:
                        y, x = waiting.pop()
                        for near in ((y + 1, x), (y - 1, x), <<sides>>):
                            if <<joins>>:
                                del blocks[near]
                                group.add(near)
                                waiting.append(near)
                    groups.append(group)
                return groups
            """,
        )
