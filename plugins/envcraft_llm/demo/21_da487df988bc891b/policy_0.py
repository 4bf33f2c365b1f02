"""Breadth-first search over slides, then follows the slides one after the other."""

from collections import deque

DIRS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class Policy:
    def slide(self, state, cell, way):
        while True:
            ahead = (cell[0] + way[0], cell[1] + way[1])
            if state.is_solid(ahead):
                return cell
            if ahead in state.holes or ahead[0] in (7, 8):
                return None
            cell = ahead

    def act(self, state):
        if state.heading:
            return [0, 0, 0]
        queue, first = deque([state.position]), {state.position: 0}
        while queue:
            cell = queue.popleft()
            if cell == state.pin:
                return [first[cell], 0, 0]
            for move, way in DIRS.items():
                end = self.slide(state, cell, way)
                if end is not None and end not in first:
                    first[end] = first[cell] or move
                    queue.append(end)
        return [0, 0, 0]
