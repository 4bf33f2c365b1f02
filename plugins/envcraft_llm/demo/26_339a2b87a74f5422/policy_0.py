"""Stand where a shot meets the lowest crab, fire, and step aside from what comes down."""


class Policy:
    def act(self, state):
        x = state.boat_x
        away = self._dodge(state, x)
        if away:
            return [away, 1, 0]
        aim = self._aim(state, x)
        move = 4 if aim > x + 0.8 else 3 if aim < x - 0.8 else 0
        return [move, int(abs(aim - x) < 3), 0]

    def _dodge(self, state, x):
        threats = [(s[0], 77 - s[1], 1.2, 5.5) for s in state.spits]
        threats += [(d[0], 77 - d[1], 0.9, 8.0) for d in state.divers]
        for tx, height, speed, width in threats:
            if -3 < height < 14 * speed and abs(tx - x) < width:
                if x < 8 or (tx < x < 76):
                    return 4
                return 3
        to_beat = -state.tick % 14
        for hx, way in state.hoppers:
            lands = hx + 12 * way
            if to_beat < 8 and abs(lands - x) < 7.5:
                return 3 if (x < lands or x > 76) and x > 8 else 4
        return 0

    def _aim(self, state, x):
        best, where = 1e9, 42.0
        for hx, _ in state.hoppers:
            if abs(hx - x) < 22:
                return hx + (8 if x > hx else -8)
        left = state.alive.sum()
        speed = 0.22 + 0.73 * (1 - left / 20) ** 2
        for diver in state.divers:
            if diver[1] < 60 and abs(diver[0] - x) < best:
                best, where = abs(diver[0] - x), diver[0]
        for column in range(5):
            rows = [row for row in range(4) if state.alive[row, column]]
            if not rows:
                continue
            row = rows[-1]
            flight = (74 - state.offset_y - 8 * row) / 3.0
            ahead = state.offset_x + 10 * column + state.heading * speed * flight
            ahead = min(max(ahead, 5), 78)
            covered = any(b[1] > 0 and abs(b[0] - ahead) <= 4 for b in state.buoys)
            cost = abs(ahead - x) - 4 * row + (12 if covered else 0)
            if cost < best:
                best, where = cost, ahead
        return where
