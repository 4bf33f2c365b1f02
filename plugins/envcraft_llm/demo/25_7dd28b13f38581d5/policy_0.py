"""The shortest way to the goal, round the bursts of static, with left and right swapped when they are."""

import heapq

WAYS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class Policy:
    def act(self, state):
        start, goal = (state.px, state.py), state.goal
        danger = {}
        for bx, by in state.bursts:
            for dx in range(-3, 4):
                for dy in range(-3, 4):
                    near = abs(dx) + abs(dy)
                    if near <= 3:
                        cell = (bx + dx, by + dy)
                        danger[cell] = danger.get(cell, 0) + (60, 30, 8, 2)[near]
        step = self._first_step(state, start, goal, danger)
        if step is None:
            return [0, 0, 0]
        here = danger.get(start, 0)
        there = danger.get((start[0] + WAYS[step][0], start[1] + WAYS[step][1]), 0)
        if there >= 30 and there > here:
            return [0, 0, 0]
        if state.swapped and step in (3, 4):
            step = 7 - step
        # A junction that has been used once is where the labyrinth would close the way back.
        ways = sum(not state.wall[start[1] + dy, start[0] + dx] for dx, dy in WAYS.values())
        pin = ways == 2 and state.heat[start[1], start[0]] >= 1 and len(state.touched) % 3 == 0
        return [step, int(pin), 0]

    def _first_step(self, state, start, goal, danger):
        queue, best = [(0, start, 0)], {}
        while queue:
            cost, cell, first = heapq.heappop(queue)
            if cell in best:
                continue
            best[cell] = first
            if cell == goal:
                return first or None
            for way, (dx, dy) in WAYS.items():
                then = (cell[0] + dx, cell[1] + dy)
                if not (0 < then[0] < 13 and 0 < then[1] < 12) or then in best:
                    continue
                # Walls may open: where no way is free, wait at the thinnest place.
                price = 40 if state.wall[then[1], then[0]] else 1
                heapq.heappush(queue, (cost + price + danger.get(then, 0), then, first or way))
        return None
