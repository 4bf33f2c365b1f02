"""Plan the shortest row of shoves that fills one more mooring; keep away from where crabs will be."""

from collections import deque

WAYS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}
COLS, ROWS = 12, 11


class Policy:
    def __init__(self):
        self.plan = []
        self.expected = None
        self.hopeless = None

    def act(self, state):
        if state.rest >= 2.0:
            return [0, 0, 0]
        here = (state.boat, sorted(state.buoys))
        if here[1] != self.hopeless and (not self.plan or here != self.expected):
            self.plan = self._search(state)
            # Where no shove helps, none will until a buoy has moved: looking again at each step takes too long.
            self.hopeless = None if self.plan else here[1]
        if state.grace < 12:
            if self._danger(state, state.boat) > 0:
                return [self._flee(state), 0, 0]
            if self.plan and self._danger(state, self._ahead(state.boat, self.plan[0])) > 0:
                return [0, 0, 0]
        if not self.plan:
            return [0, 0, 0]
        way = self.plan.pop(0)
        cell = self._ahead(state.boat, way)
        self.expected = (cell, sorted(self._ahead(b, way) if b == cell else b for b in state.buoys))
        return [way, 0, 0]

    def _ahead(self, cell, way):
        return cell[0] + WAYS[way][0], cell[1] + WAYS[way][1]

    def _danger(self, state, cell):
        """How near crabs will come to a cell in the next steps."""
        x, y = state.middle(cell)
        worst = 0.0
        for crab in state.crabs:
            for k in range(0, 10, 2):
                gap = max(abs(crab.x + k * crab.vx - x), abs(crab.y + k * crab.vy - y))
                worst = max(worst, 8.0 - gap)
        return worst

    def _flee(self, state):
        choices = [(self._danger(state, state.boat) - 0.5, 0)]
        for way in WAYS:
            cell = self._ahead(state.boat, way)
            if state.open(cell):
                choices.append((self._danger(state, cell), way))
        return min(choices)[1]

    def _search(self, state):
        best = None
        for mark in state.marks:
            if mark in state.buoys:
                continue
            for number, buoy in enumerate(state.buoys):
                if buoy in state.marks:
                    continue
                found = self._push(state, number, mark, 400 if best is None else len(best))
                if found and (best is None or len(found) < len(best)):
                    best = found
        return best or []

    def _push(self, state, number, mark, most):
        walls = {buoy for k, buoy in enumerate(state.buoys) if k != number}
        start = (state.boat, state.buoys[number])
        came, queue = {start: None}, deque([(start, 0)])
        while queue:
            node, moves = queue.popleft()
            boat, buoy = node
            if buoy == mark:
                plan = []
                while came[node] is not None:
                    node, way = came[node]
                    plan.append(way)
                return plan[::-1]
            if moves >= most:
                return None
            for way in WAYS:
                cell, pushed = self._ahead(boat, way), buoy
                if cell == buoy:
                    pushed = self._ahead(cell, way)
                    if pushed in walls or not (0 <= pushed[0] < COLS and 0 <= pushed[1] < ROWS):
                        continue
                if cell in walls or not (0 <= cell[0] < COLS and 0 <= cell[1] < ROWS):
                    continue
                then = (cell, pushed)
                if then not in came:
                    came[then] = (node, way)
                    queue.append((then, moves + 1))
        return None
