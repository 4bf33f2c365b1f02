"""A look at games of cells: things that the player gathers, and that walls enclose on some seeds."""

from __future__ import annotations

import itertools
from collections import Counter, deque
from typing import Any, NamedTuple

import numpy as np
from envcraft_protocol.wire import MAX_LOOKS

from .tree import Tree

#: Seeds of random play, and of play that gathers things.
_PLAYED, _GUIDED = 6, 3
#: Number of episodes that the budget is meant for: the same three again if two lists may be the things.
_EPISODES = 12
#: For how many steps random play holds an action.
_HOLDS = (1, 2, 3, 5)
#: The shortest and the longest side of a grid.
_SIDES = range(4, 41)
#: How often the player must be seen beside a wall, on other cells, and to gather a thing.
_BESIDE, _WALKED, _GATHERED = 8, 12, 2
#: The share of the cells that walls have at least. Doors and hazards have fewer.
_SHARE = 0.05
#: How the names of two attributes end that are a cell together.
_ENDS = (("x", "y"), ("row", "col"), ("r", "c"))
_AROUND = ((-1, 0), (1, 0), (0, -1), (0, 1))

_Cell = tuple[int, int]


class _Scene(NamedTuple):
    """What the attributes of an environment may mean: grids, single cells, and several cells, by name."""

    grids: dict[str, Any]
    cells: dict[str, _Cell]
    things: dict[str, frozenset[_Cell]]


class _Play(NamedTuple):
    scenes: list[_Scene]
    actions: list[Any]


def enclosed(tree: Tree) -> None:
    """Find the seeds on which a thing that the player gathers lies where no way leads, past walls that stay.

    Play shows what the attributes mean. The player's cell moves by one cell at most, and what it comes to leaves the
    list of things. A wall is a value of the grid that the player never stands on, though often beside it. Any other
    value counts as a way, so a door or a hazard encloses nothing.
    """
    env = tree.subject.construct(announce=False)
    tree.subject.call("reset", env.reset, seed=tree.seed)
    start = _scene(env)
    if not all(start):
        return
    plays = [_played(tree, env, tree.seed + number, _Player(tree)) for number in range(_PLAYED)]
    for name, grid, turned in itertools.product(start.cells, start.grids, (False, True)):
        walls = _walls(plays, name, grid, turned)
        for things in start.things if walls else ():
            if tree.spent() or _gathered(plays, name, things) is None:
                continue
            board = _Board(name, things, grid, turned, walls)
            player = _Gatherer(tree, board, _moves(plays, name))
            every = [*plays, *(_played(tree, env, tree.seed + number, player) for number in range(_GUIDED))]
            often = (_gathered(every, name, things) or 0) >= _GATHERED
            if often and walls <= _walls(every, name, grid, turned):
                _look(tree, env, board)
                return


class _Board(NamedTuple):
    """Which attributes are the player's cell, the things and the grid, whether the grid is turned, and its walls."""

    player: str
    things: str
    grid: str
    turned: bool
    walls: set[Any]

    def left(self, scene: _Scene) -> tuple[frozenset[_Cell], dict[_Cell, _Cell]]:
        """The things of a scene, and how each cell that the player can come to is reached; none if it does not fit."""
        if self.player not in scene.cells or self.grid not in scene.grids:
            return frozenset(), {}
        table = _turned(scene.grids[self.grid], self.turned)
        if not _inside(scene.cells[self.player], table):
            return frozenset(), {}
        return scene.things.get(self.things, frozenset()), _reached(table, scene.cells[self.player], self.walls)

    def has(self, scene: _Scene, cell: _Cell) -> bool:
        """Whether a cell is one of the grid's."""
        return _inside(cell, _turned(scene.grids[self.grid], self.turned))


def _look(tree: Tree, env: Any, board: _Board) -> None:
    tree.out.player, tree.out.place, tree.out.board = board.player, board.things, board.grid
    for number in range(MAX_LOOKS):
        tree.subject.call("reset", env.reset, seed=tree.seed + number)
        scene = _scene(env)
        left, ways = board.left(scene)
        if ways:
            tree.out.looked += 1
            tree.out.placed = max(tree.out.placed, len(left))
            if any(cell not in ways and board.has(scene, cell) for cell in left):
                tree.out.enclosed.append(number)


class _Player:
    """Plays at random, with held actions."""

    def __init__(self, tree: Tree) -> None:
        self._tree = tree
        self._action, self._held = None, 0

    def choose(self, scene: _Scene) -> Any:
        if not self._held:
            self._action, self._held = self._tree.random.choice(self._tree.actions), self._tree.random.choice(_HOLDS)
        self._held -= 1
        return self._action


class _Gatherer(_Player):
    """Goes to the nearest thing, by actions whose effect is known; every fourth action is one at random."""

    def __init__(self, tree: Tree, board: _Board, moves: dict[_Cell, Any]) -> None:
        super().__init__(tree)
        self._board, self._moves = board, moves

    def choose(self, scene: _Scene) -> Any:
        left, ways = self._board.left(scene)
        cell = next((each for each in ways if each in left), None)
        if cell is None or not self._tree.random.randrange(4):
            return super().choose(scene)
        here = scene.cells[self._board.player]
        while ways[cell] != here:
            cell = ways[cell]
        move = cell[0] - here[0], cell[1] - here[1]
        return self._moves[move] if move in self._moves else super().choose(scene)


def _played(tree: Tree, env: Any, seed: int, player: _Player) -> _Play:
    """The scenes of an episode, and the actions between them."""
    tree.subject.call("reset", env.reset, seed=seed)
    scenes, actions = [_scene(env)], []
    for _ in range(tree.budget // _EPISODES):
        action = player.choose(scenes[-1])
        _, _, terminated, truncated, _ = tree.subject.step("step", env, action)
        tree.out.steps += 1
        if terminated or truncated:
            break
        scenes.append(_scene(env))
        actions.append(action)
    return _Play(scenes, actions)


def _moves(plays: list[_Play], name: str) -> dict[_Cell, Any]:
    """For each move to another cell, the action that led to it most often."""
    led: dict[_Cell, Counter[str]] = {}
    known: dict[str, Any] = {}
    for play in plays:
        for (before, after), action in zip(itertools.pairwise(play.scenes), play.actions, strict=True):
            cell, other = before.cells.get(name), after.cells.get(name)
            if cell is not None and other is not None and cell != other:
                known[repr(action)] = action
                led.setdefault((other[0] - cell[0], other[1] - cell[1]), Counter())[repr(action)] += 1
    return {move: known[counts.most_common(1)[0][0]] for move, counts in led.items()}


def _scene(env: Any) -> _Scene:
    scene = _Scene({}, {}, {})
    for name, value in vars(env.unwrapped).items():
        if (cell := _cell(value)) is not None:
            scene.cells[name] = cell
        elif (grid := _grid(value)) is not None:
            scene.grids[name] = grid
        elif isinstance(value, list | set | frozenset | tuple):
            cells = [_cell(each) for each in value]
            if None not in cells:
                scene.things[name] = frozenset(cell for cell in cells if cell is not None)
    held = {name: int(value) for name, value in vars(env.unwrapped).items() if type(value) in (int, np.int64)}
    for (end, other), (name, value) in itertools.product(_ENDS, held.items()):
        partner = name.removesuffix(end) + other
        if name.endswith(end) and partner in held:
            scene.cells[f"{name}, {partner}"] = value, held[partner]
    return scene


def _cell(value: Any) -> _Cell | None:
    if isinstance(value, np.ndarray) and value.shape == (2,) and value.dtype.kind in "iu":
        value = value.tolist()
    whole = isinstance(value, tuple | list) and all(type(each) is int or isinstance(each, np.integer) for each in value)
    return (int(value[0]), int(value[1])) if whole and len(value) == 2 else None


def _grid(value: Any) -> Any:
    """A copy of a table of small numbers, booleans or letters; None for anything else."""
    if isinstance(value, list | tuple) and len(value) in _SIDES and all(isinstance(row, str | list) for row in value):
        plain = {type(each) for row in value for each in row}
        if len({len(row) for row in value}) == 1 and plain in ({int}, {bool}, {str}):
            value = np.array([list(row) for row in value])
    table = isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "biuU"
    return value.copy() if table and all(side in _SIDES for side in value.shape) else None


def _turned(grid: Any, turned: bool) -> Any:
    return grid.T if turned else grid


def _gathered(plays: list[_Play], name: str, things: str) -> int | None:
    """How many things vanish at the cell that comes to them; None if it does not walk, or others vanish or appear."""
    gathered = 0
    for before, after in (pair for play in plays for pair in itertools.pairwise(play.scenes)):
        if not all(name in scene.cells and things in scene.things for scene in (before, after)):
            return None
        cell, other = before.cells[name], after.cells[name]
        gone = before.things[things] - after.things[things]
        if abs(cell[0] - other[0]) + abs(cell[1] - other[1]) > 1 or gone - {other}:
            return None
        if after.things[things] - before.things[things]:
            return None
        gathered += len(gone)
    return gathered


def _walls(plays: list[_Play], name: str, grid: str, turned: bool) -> set[Any]:
    """The common values of the grid that the player never stands on, though often beside; none if play changes it."""
    stood: set[Any] = set()
    beside: Counter[Any] = Counter()
    every: Counter[Any] = Counter()
    walked = 0
    for scenes, _ in plays:
        if any(name not in scene.cells or grid not in scene.grids for scene in scenes):
            return set()
        if not all(np.array_equal(scenes[0].grids[grid], scene.grids[grid]) for scene in scenes):
            return set()
        table = _turned(scenes[0].grids[grid], turned)
        visited = {scene.cells[name] for scene in scenes}
        if any(not _inside(cell, table) for cell in visited):
            return set()
        walked += len(visited)
        every.update(table.ravel().tolist())
        stood |= {table[cell].item() for cell in visited}
        near = {(row + down, column + right) for row, column in visited for down, right in _AROUND} - visited
        beside.update(table[cell].item() for cell in near if _inside(cell, table))
    common = {value for value, times in every.items() if times >= _SHARE * every.total()}
    found = {value for value, times in beside.items() if times >= _BESIDE and value in common - stood}
    return found if walked >= _WALKED else set()


def _inside(cell: _Cell, table: Any) -> bool:
    rows, columns = table.shape
    return 0 <= cell[0] < int(rows) and 0 <= cell[1] < int(columns)


def _reached(table: Any, start: _Cell, walls: set[Any]) -> dict[_Cell, _Cell]:
    """The cells that lie on a way from the start or beside one, the nearest first, each with the cell before it."""
    before = {start: start}
    waiting = deque([start])
    while waiting:
        row, column = waiting.popleft()
        for down, right in _AROUND:
            cell = row + down, column + right
            if cell not in before and _inside(cell, table):
                before[cell] = row, column
                if table[cell].item() not in walls:
                    waiting.append(cell)
    return before
