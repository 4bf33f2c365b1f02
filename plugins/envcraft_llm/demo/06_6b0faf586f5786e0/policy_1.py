"""Fetch the loaf that is nearest by digging, away from mice and from whatever hangs loose; then walk to the oven."""

import heapq

WAYS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}
EMPTY, DOUGH, SACK, LOAF, OVEN = range(5)


class Policy:
    def act(self, state):
        grid = state.grid
        if state.gathered >= 8:
            goals = {(11, 10)}
        else:
            goals = {(c, r) for r in range(11) for c in range(12) if grid[r, c] == LOAF}
        move = self._way(state, goals)
        return [move, 0, 0]

    def _way(self, state, goals):
        queue = [(0.0, state.baker, 0)]
        done = set()
        while queue:
            cost, cell, first = heapq.heappop(queue)
            if cell in done:
                continue
            done.add(cell)
            if cell in goals and first:
                return first
            for move, (dx, dy) in WAYS.items():
                ahead = (cell[0] + dx, cell[1] + dy)
                kind = state.at(ahead)
                if not state._inside(ahead) or kind == SACK or (kind == OVEN and ahead not in goals):
                    continue
                heapq.heappush(queue, (cost + self._price(state, ahead, cell == state.baker), ahead, first or move))
        return 0

    @staticmethod
    def _price(state, cell, now):
        column, row = cell
        price = 1.0
        for mouse in state.mice:
            gap = abs(mouse["at"][0] - column) + abs(mouse["at"][1] - row)
            price += 20.0 if gap <= 1 else 4.0 if gap == 2 else 0.0
        above = [(column, row - n) for n in (1, 2)]
        if now and any(place in state.falling for place in above):
            price += 40.0
        if state.at(above[0]) in (SACK, LOAF) and row > 0:
            price += 3.0
        if column * 7 < state.dark + 6:
            price += 10.0
        return price
