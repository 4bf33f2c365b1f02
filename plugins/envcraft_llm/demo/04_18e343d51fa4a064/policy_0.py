"""Dig the cheapest way to the nearest coin, wear the colour of whatever flies along the row, cool down in time."""

import heapq

MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class Policy:
    def act(self, state):
        goals = set(state.coins) or {state.ladder}
        if state.heat > 48:
            goals = state.shadows()
        if state.robot in goals and state.heat > 20 and state.robot in state.shadows():
            move = 0
        else:
            move = self._first_move(state, goals)
        return [move, self._swap(state), 0]

    @staticmethod
    def _swap(state):
        """Swap when the nearest alligator that comes along this row has the other colour."""
        column, row = state.robot
        coming = [g for g in state.gators if g["row"] == row and (column - g["x"]) * g["way"] >= 0]
        if not coming:
            return 0
        nearest = min(coming, key=lambda g: abs(column - g["x"]))
        return int(nearest["light"] != state.light)

    @staticmethod
    def _first_move(state, goals):
        wheels = {wheel["at"] for wheel in state.wheels}
        under = {(c, r + n) for c, r in wheels for n in (1, 2)}
        queue = [(0, state.robot, 0)]
        done = set()
        while queue:
            cost, cell, first = heapq.heappop(queue)
            if cell in done:
                continue
            done.add(cell)
            if cell in goals and first:
                return first
            for move, (dx, dy) in MOVES.items():
                column, row = cell[0] + dx, cell[1] + dy
                if not (0 <= column < 14 and 0 <= row < 13) or (column, row) in wheels:
                    continue
                price = 2 if state.earth[row, column] else 1
                price += 12 * ((column, row) in under) + 5 * (0 < state.traps.get((column, row), 0) < 4)
                heapq.heappush(queue, (cost + price, (column, row), first or move))
        return 0
