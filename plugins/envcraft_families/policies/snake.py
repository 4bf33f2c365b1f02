"""Plays the family `snake`: the shortest way to a meal from which the tail can still be reached.

The text of this file is the policy that runs beside the environment, so it needs nothing but the standard library.
"""

from __future__ import annotations

from collections import deque
from typing import Any

Cell = tuple[int, int]
_DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))


class SnakePolicy:
    """Plays one episode."""

    def act(self, state: Any) -> tuple[int, int, int]:
        view = state.get_state()
        field = _Field(view)
        heading = tuple(view["heading"])
        step = field.choose([tuple(cell) for cell in view["body"]], heading)
        if not view["turns"]:
            return 1 + _DIRECTIONS.index(step), 0, 0
        y, x = heading
        return {(-x, y): 3, (x, -y): 4}.get(step, 1), 0, 0


class _Field:
    """The field without the snake. Cells of poison are walls."""

    def __init__(self, view: dict[str, Any]) -> None:
        self.rows: int = view["rows"]
        self.columns: int = view["columns"]
        self.wrap: bool = view["wrap"]
        self.walls = [row[:] for row in view["walls"]]
        for y, x in view["poison"]:
            self.walls[y][x] = True
        self.food: set[Cell] = {(y, x) for y, x in view["food"]}
        self.growing = view["growing"]

    def choose(self, body: list[Cell], heading: Cell) -> Cell:
        """The direction of the next move."""
        back = (-heading[0], -heading[1])
        way = self._way(body, self.food, back)
        if way and self._safe_after(body, way):
            return self._direction(body[0], way[0])
        # Nothing to eat safely: keep away from the meal, as long as the tail can be reached.
        ranked = []
        for direction in _DIRECTIONS:
            cell = self._next(body[0], direction)
            if direction == back or cell is None or cell in body[: len(body) - (not self.growing)]:
                continue
            moved = [cell, *body[: len(body) - (not self.growing)]]
            after = max(0, self.growing - 1)
            rating = (cell != body[-1], self._tail_near(moved, after), self._reach(moved, after), self._far(moved))
            ranked.append((*rating, direction))
        return max(ranked)[-1] if ranked else heading

    def _next(self, cell: Cell, direction: Cell) -> Cell | None:
        y, x = cell[0] + direction[0], cell[1] + direction[1]
        if self.wrap:
            y, x = y % self.rows, x % self.columns
        elif not (0 <= y < self.rows and 0 <= x < self.columns):
            return None
        return None if self.walls[y][x] else (y, x)

    def _direction(self, cell: Cell, goal: Cell) -> Cell:
        return next(direction for direction in _DIRECTIONS if self._next(cell, direction) == goal)

    def _way(self, body: list[Cell], goals: set[Cell], back: Cell) -> list[Cell]:
        """The shortest way of the head to a goal. A cell of the body is free once the tail has left it."""
        # Some snakes also grow with time, so the cell of the tail counts as taken for one more move.
        leaves = {cell: len(body) - place + self.growing + 1 for place, cell in enumerate(body)}
        before: dict[Cell, Cell | None] = {body[0]: None}
        waiting: deque[tuple[Cell, int]] = deque([(body[0], 0)])
        while waiting:
            cell, moves = waiting.popleft()
            for direction in _DIRECTIONS:
                if moves == 0 and direction == back:
                    continue
                beside = self._next(cell, direction)
                if beside is None or beside in before or leaves.get(beside, 0) > moves + 1:
                    continue
                before[beside] = cell
                if beside in goals:
                    way: list[Cell] = []
                    at: Cell | None = beside
                    while at is not None:
                        way.append(at)
                        at = before[at]
                    return way[-2::-1]
                waiting.append((beside, moves + 1))
        return []

    def _safe_after(self, body: list[Cell], way: list[Cell]) -> bool:
        """Whether the tail can be reached after the way, or most of the field."""
        keep = len(body) + min(self.growing, len(way))
        moved = [*reversed(way), *body][:keep]
        growing = max(0, self.growing - len(way)) + 3
        return self._tail_near(moved, growing) or self._reach(moved, growing) > 2 * len(moved) + 6

    def _tail_near(self, body: list[Cell], growing: int) -> bool:
        """Whether the head can go to a cell beside the tail, with room to wait there until the snake has grown."""
        known = self._flood(body) - {body[0]}
        near = any(self._next(body[-1], direction) in known for direction in _DIRECTIONS)
        return len(body) < 4 or (near and len(known) > growing + 3)

    def _reach(self, body: list[Cell], growing: int) -> int:
        """The number of cells that the head can go to."""
        return len(self._flood(body)) - growing

    def _flood(self, body: list[Cell]) -> set[Cell]:
        blocked, known, waiting = set(body[1:-1]), {body[0]}, [body[0]]
        while waiting:
            cell = waiting.pop()
            for direction in _DIRECTIONS:
                beside = self._next(cell, direction)
                if beside is not None and beside not in known and beside not in blocked:
                    known.add(beside)
                    waiting.append(beside)
        return known

    def _far(self, body: list[Cell]) -> int:
        y, x = body[0]
        return min(abs(y - row) + abs(x - column) for row, column in self.food)
