"""Gather this room's marble, line up with a cube behind the next window, trade places, go on."""

import heapq

WAYS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}
ROOMS = (0, 0, 0, 0, None, 1, 1, 1, 1, None, 2, 2, 2, 2)
BELTS = (1, 7, 12)


class Policy:
    def act(self, state):
        room = ROOMS[state.soldier[0]]
        if not state.gathered[room]:
            marbles = {cell for cell in state.marbles if ROOMS[cell[0]] == room}
            return [self._way(state, marbles or self._waiting(state, room)), 0, 0]
        step = 1 if not all(state.gathered[room:]) else -1
        stands = self._stands(state, room, step)
        if state.soldier in stands:
            return [4 if step > 0 else 3, int(not state.cooldown), 0]
        return [self._way(state, stands or self._waiting(state, room)), 0, 0]

    @staticmethod
    def _waiting(state, room):
        """Beside the belt, half way up."""
        return {
            (BELTS[room] + side, row) for side in (-1, 1) for row in (5, 7) if state.free((BELTS[room] + side, row))
        }

    @staticmethod
    def _stands(state, room, step):
        """Cells from which a cube in the next room can be seen through a window."""
        edge = {1: (3, 8, 13), -1: (0, 5, 10)}[step][room]
        rows = {row for column, row in state.cubes if ROOMS[column] == room + step and row in (2, 4, 6, 8, 10)}
        return {(edge, row) for row in rows if state.free((edge, row))}

    def _way(self, state, goals):
        if state.soldier in goals:
            return 0
        queue, done = [(0.0, state.soldier, 0)], set()
        while queue:
            cost, cell, first = heapq.heappop(queue)
            if cell in done:
                continue
            done.add(cell)
            if cell in goals:
                return first
            for move, (dx, dy) in WAYS.items():
                ahead = (cell[0] + dx, cell[1] + dy)
                if state.free(ahead):
                    heapq.heappush(queue, (cost + self._price(state, ahead), ahead, first or move))
        return 0

    @staticmethod
    def _price(state, cell):
        price = 1.0
        for beetle, _ in state.beetles:
            gap = abs(beetle[0] - cell[0]) + abs(beetle[1] - cell[1])
            price += 30.0 if gap == 0 else 12.0 if gap == 1 else 0.0
        if state.fire[cell[1], cell[0]]:
            price += 3.0 if state.water > 2 else 30.0
        if cell[0] in BELTS and cell[1] >= 11:
            price += 40.0
        return price
