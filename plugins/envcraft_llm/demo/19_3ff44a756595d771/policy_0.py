"""Cuts boxes out of the open: three straight legs from claimed ground back to claimed ground, far from the trucks."""

WAYS = {1: (-1, 0), 2: (1, 0), 3: (0, -1), 4: (0, 1)}


class Policy:
    def __init__(self):
        self.plan = []
        self.lives = None
        self.heading = 4

    def act(self, state):
        if state.lives != self.lives or (not state.line and state.grace == 20):
            self.plan, self.lives = [], state.lives
        hook = 1 if state.ripple is not None else 0
        if self.plan and state.fork == self.plan[0][1]:
            self.plan.pop(0)
        if not self.plan and not state.line:
            self.plan = self.best_box(state)
        if self.plan:
            return [self.plan[0][0], 1, hook]
        if state.line:  # the plan is lost: back to claimed ground by the nearest way
            return [self.home(state), 1, hook]
        return [self.walk(state), 0, hook]

    def inside(self, cell):
        return 0 <= cell[0] < 24 and 0 <= cell[1] < 28

    def leg(self, state, cell, move, length):
        """Cells of a straight line through the open, up to the claimed cell where it ends, if it does."""
        cells = []
        for _ in range(length):
            cell = (cell[0] + WAYS[move][0], cell[1] + WAYS[move][1])
            if not self.inside(cell):
                return cells, False
            cells.append((move, cell))
            if state.ground[cell] == 1:
                return cells, True
        return cells, False

    def best_box(self, state):
        counts = state.counts()
        best, chosen = 2.5, []
        for out in WAYS:
            for along in (3, 4) if out in (1, 2) else (1, 2):
                back = {1: 2, 2: 1, 3: 4, 4: 3}[out]
                for depth in (3, 4, 5, 6):
                    first, closed = self.leg(state, state.fork, out, depth)
                    if closed or len(first) < depth:
                        break
                    for width in (3, 4, 5, 6, 7):
                        second, closed = self.leg(state, first[-1][1], along, width)
                        if not closed and len(second) < width:
                            break
                        third, done = ([], True) if closed else self.leg(state, second[-1][1], back, depth + 1)
                        path = first + second + third
                        if done and self.safe(state, path):
                            rows = [cell[0] for _, cell in path]
                            cols = [cell[1] for _, cell in path]
                            value = self.value(state, counts, min(rows), max(rows), min(cols), max(cols)) / (len(path) + 3)
                            if value * 10 > best:
                                best, chosen = value * 10, path
                        if closed:
                            break
        return chosen

    def value(self, state, counts, top, bottom, left, right):
        tally = [0, 0, 0, 0]
        for row in range(top, bottom + 1):
            for col in range(left, right + 1):
                if state.ground[row, col] == 0:
                    tally[state.colour[row, col]] += 1
        colour = tally.index(max(tally))
        others = sum(counts) - counts[colour]
        if state.last_colours[-2:] == [colour, colour] and others + state.burst >= 100:
            return -1.0
        return tally[colour] * (1.5 if counts[colour] == max(counts) else 0.8)

    def safe(self, state, path):
        steps = 2 * len(path) + 2
        for row, col, _, _ in state.trucks:
            near = min(max(abs(row - cell[0]), abs(col - cell[1])) for _, cell in path)
            if near <= min(steps / 3, 6):
                return False
        return True

    def home(self, state):
        row, col = state.fork
        reach = []
        for move in WAYS:
            cells, closed = self.leg(state, (row, col), move, 30)
            if closed and all(state.ground[cell] != 2 for _, cell in cells):
                reach.append((len(cells), move))
        return min(reach)[1] if reach else 0

    def walk(self, state):
        """Along the border, away from sparks that come near."""
        options = []
        for move, way in WAYS.items():
            cell = (state.fork[0] + way[0], state.fork[1] + way[1])
            if self.inside(cell) and state.ground[cell] == 1:
                spark = min(abs(s[0] - cell[0]) + abs(s[1] - cell[1]) for s in state.sparks)
                back = {1: 2, 2: 1, 3: 4, 4: 3}[self.heading] == move
                border = 0 if state._on_border(*cell) else 3
                options.append((min(spark, 6) * 2 - 5 * back - border + (move == self.heading), move))
        if not options:
            return 0
        self.heading = max(options)[1]
        return self.heading
