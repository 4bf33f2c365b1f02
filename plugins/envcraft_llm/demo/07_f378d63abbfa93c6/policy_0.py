"""Head for the spring, but never into a cell that is taken or closes a trap."""

from collections import deque

MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class Policy:
    def act(self, state):
        head, taken = state.way[0], set(state.body)
        best, choice = None, 0
        for move, (dx, dy) in MOVES.items():
            if (dx + state.heading[0], dy + state.heading[1]) == (0, 0):
                continue
            cell = (head[0] + dx, head[1] + dy)
            if not state._inside(cell) or cell in taken:
                continue
            room = self._room(state, cell, taken)
            gap = abs(cell[0] - state.spring[0]) + abs(cell[1] - state.spring[1])
            key = (room > state.length, -gap)
            if best is None or key > best:
                best, choice = key, move
        return [choice, 0, 0]

    @staticmethod
    def _room(state, start, taken):
        queue, seen = deque([start]), {start}
        while queue and len(seen) < 60:
            column, row = queue.popleft()
            for dx, dy in MOVES.values():
                cell = (column + dx, row + dy)
                if cell not in seen and cell not in taken and state._inside(cell):
                    seen.add(cell)
                    queue.append(cell)
        return len(seen)
