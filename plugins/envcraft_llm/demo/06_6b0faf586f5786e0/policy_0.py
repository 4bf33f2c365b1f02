"""Keep the nearest loaf as a target until it is gathered, then walk to the oven."""

from collections import deque

WAYS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}
SACK, LOAF, OVEN = 2, 3, 4


class Policy:
    def act(self, state):
        loaves = [(c, r) for r in range(11) for c in range(12) if state.grid[r, c] == LOAF]
        if getattr(state, "target", None) not in loaves:
            state.target = min(loaves, key=lambda cell: abs(cell[0] - state.baker[0]) + abs(cell[1] - state.baker[1]))
        goal = (11, 10) if state.gathered >= 8 else state.target
        return [self._way(state, goal), 0, 0]

    @staticmethod
    def _way(state, goal):
        queue, seen = deque([(state.baker, 0)]), {state.baker}
        while queue:
            cell, first = queue.popleft()
            if cell == goal:
                return first
            for move, (dx, dy) in WAYS.items():
                ahead = (cell[0] + dx, cell[1] + dy)
                if ahead not in seen and (ahead == goal or state.at(ahead) not in (SACK, OVEN)):
                    seen.add(ahead)
                    queue.append((ahead, first or move))
        return 0
