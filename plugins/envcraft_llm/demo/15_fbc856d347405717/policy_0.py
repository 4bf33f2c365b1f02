"""Shoves the block that is nearest to the largest one against it, one axis after the other.

Where a block lies so close to a wall that nobody can get behind it, the room is widened first.
"""

from collections import deque

import numpy as np

C, SLAB = 44.0, 8


class Policy:
    def act(self, state):
        breath = self.breath(state)
        move = self.walk(state)
        if move in (1, 2) and state.explorer[0] < state.line:
            move = 3 - move
        return [move, *breath]

    def breath(self, state):
        """Keep the room wide enough to walk behind every slab, but never at its widest for long."""
        if state.half < 33:
            return [0, 1]
        return [0, 0]

    def walk(self, state):
        self.spread(state)
        groups = {}
        for i, number in enumerate(state.group):
            groups.setdefault(number, []).append(i)
        pairs = []
        for i in range(5):
            for j in range(5):
                if state.group[i] == state.group[j]:
                    continue
                if state.touching(i, j):
                    return self.wait(state)
                size = len(groups[state.group[i]])
                dx = state.slabs[j][0] - state.slabs[i][0]
                dy = state.slabs[j][1] - state.slabs[i][1]
                pairs.append((abs(dx) + abs(dy) + 15 * size, i, dx, dy))
        for _, i, dx, dy in sorted(pairs):
            wishes = []
            if abs(dy) > 5:
                wishes.append((0, 1 if dy > 0 else -1))
            if abs(dx) > 5:
                wishes.append((1 if dx > 0 else -1, 0))
            # First the axis in which the slabs are nearly in line.
            if abs(dx) < abs(dy):
                wishes.reverse()
            for way in wishes:
                if not state._group_blocked(state.group[i], 1.5 * way[0], 1.5 * way[1]):
                    move = self.shove(state, i, way)
                    if move is not None:
                        return move
        return self.wait(state)

    def shove(self, state, i, way):
        """Walk behind slab i and then against it."""
        x, y = state.slabs[i]
        ex, ey = state.explorer
        behind = (x - way[0] * 7.6, y - way[1] * 7.6)
        across = abs(ey - y) if way[0] else abs(ex - x)
        along = (x - ex) * way[0] + (y - ey) * way[1]
        if across < 2.5 and 5 < along < 10:
            return {(1, 0): 4, (-1, 0): 3, (0, 1): 2, (0, -1): 1}[way]
        return self.path(state, behind)

    def path(self, state, goal):
        """First move of a shortest way to the cell nearest to the goal; None where there is none."""
        key = (round((goal[0] - state.explorer[0]) / 1.5), round((goal[1] - state.explorer[1]) / 1.5))
        return self.first_moves.get(key)

    def spread(self, state):
        """Breadth first over the cells of a grid of single steps around the explorer: first move to each."""
        offsets = 1.5 * np.arange(-50, 51)
        xs, ys = state.explorer[0] + offsets, state.explorer[1] + offsets
        inside = state.half - 2
        free = (np.abs(xs - C) <= inside)[:, None] & (np.abs(ys - C) <= inside)[None, :]
        for solid, reach in ((state.slabs, 6.1), (state.serpents, 6.0)):
            for thing in solid:
                free &= (np.abs(xs - thing[0]) >= reach)[:, None] | (np.abs(ys - thing[1]) >= reach)[None, :]
        moves = ((1, 0, -1), (2, 0, 1), (3, -1, 0), (4, 1, 0))
        self.first_moves = {(0, 0): 0}
        queue = deque([(0, 0)])
        while queue:
            x, y = queue.popleft()
            for move, dx, dy in moves:
                cell = (x + dx, y + dy)
                if cell not in self.first_moves and free[cell[0] + 50, cell[1] + 50]:
                    self.first_moves[cell] = self.first_moves[x, y] or move
                    queue.append(cell)

    def wait(self, state):
        """Keep away from the serpents."""
        x, y = state.explorer
        best, move = -1.0, 0
        for number, (dx, dy) in {0: (0, 0), 1: (0, -1.5), 2: (0, 1.5), 3: (-1.5, 0), 4: (1.5, 0)}.items():
            spot = (x + dx, y + dy)
            if any(max(abs(sx - spot[0]), abs(sy - spot[1])) < 6.1 for sx, sy in state.slabs):
                continue
            room = min([max(abs(s[0] - spot[0]), abs(s[1] - spot[1])) for s in state.serpents] or [99])
            if min(room, 9) > best:
                best, move = min(room, 9), number
        return move
