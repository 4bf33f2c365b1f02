"""Solves the lamps as linear equations over GF(2), walks to each lamp of the solution and presses."""

import itertools

import numpy as np


class Policy:
    def solution(self, lamps):
        """The presses that put all lamps out: try all first rows and chase the lights downwards."""
        best = None
        for first in itertools.product((0, 1), repeat=5):
            field = lamps.astype(int).copy()
            presses = []
            row_presses = list(first)
            for row in range(5):
                for column in range(5):
                    if row_presses[column]:
                        presses.append((column + 1, row + 1))
                        for dc, dr in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
                            if 0 <= column + dc < 5 and 0 <= row + dr < 5:
                                field[row + dr, column + dc] ^= 1
                row_presses = field[row].tolist()
            if not field.any() and (best is None or len(presses) < len(best)):
                best = presses
        return best or []

    def act(self, state):
        presses = self.solution(np.asarray(state.lamps))
        if not presses:
            return [0, 0, 0]
        column, row = min(presses, key=lambda p: abs(p[0] - state.cat[0]) + abs(p[1] - state.cat[1]))
        x, y = state.cat
        if (x, y) == (column, row):
            return [0, 0 if state.button_was_down else 1, 0]
        if y > 5:
            return [1, 0, 0]  # up onto the field first
        if x != column:
            return [4 if column > x else 3, 0, 0]
        return [2 if row > y else 1, 0, 0]
