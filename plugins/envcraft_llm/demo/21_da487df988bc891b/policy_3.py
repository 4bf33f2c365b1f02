"""Search over slides with planks: a slide from the bank may cross the channel once a plank has been laid there."""

from collections import deque

DIRS = {1: (-1, 0), 2: (1, 0), 3: (0, -1), 4: (0, 1)}  # row, column


class Policy:
    def slide(self, state, cell, way):
        row, column = cell
        bank = column + way[1] in (7, 8)
        while True:
            row, column = row + way[0], column + way[1]
            if state.is_solid((row, column)):
                return (row - way[0], column - way[1])
            if (row, column) in state.holes or (column in (7, 8) and not bank):
                return None

    def act(self, state):
        if state.heading:
            return [0, 0, 0]
        start = (state.position[1], state.position[0])
        goal = (state.pin[1], state.pin[0])
        queue, first = deque([start]), {start: 0}
        while queue:
            cell = queue.popleft()
            if cell == goal:
                break
            for move, way in DIRS.items():
                end = self.slide(state, cell, way)
                if end is not None and end not in first:
                    first[end] = first[cell] or move
                    queue.append(end)
        move = first.get(goal, 0)
        if move == 4 and start[0] == 6 and start[1] not in state.planks:
            return [4, 1, 0]
        return [move, 0, 0]
