"""Sow in safe places around the middle, come back when they are ripe, steer by proportional-derivative control."""

import math


class Policy:
    def act(self, state):
        target, press = self._choose(state)
        # Whatever is bare underfoot is sown in passing, while the bed is small enough to be guarded.
        sow = len(state.plants) < 10 and self._free(state, state.x, state.y)
        return [self._steer(state, *target), int(press or sow), 0]

    def _choose(self, state):
        prowling = [i for i in state.imps if not i["fleeing"] and (i["prey"] == "friend" or state.plants)]
        close = [i for i in prowling if self._urgent(state, i)]
        ripe = [p for p in state.plants if p[2] >= 50]
        if close and not any(math.hypot(p[0] - state.x, p[1] - state.y) < 6 for p in ripe):
            imp = min(close, key=lambda i: math.hypot(i["x"] - state.x, i["y"] - state.y))
            return (min(max(imp["x"], 16), 68), min(max(imp["y"], 16), 68)), False
        if ripe:
            plant = min(ripe, key=lambda p: math.hypot(p[0] - state.x, p[1] - state.y))
            return (plant[0], plant[1]), math.hypot(plant[0] - state.x, plant[1] - state.y) < 3.5
        if len(state.plants) + state.harvested < 18 and len(state.plants) < 8:
            spots = [(x, y) for x in range(28, 59, 7) for y in range(32, 63, 7) if self._free(state, x, y)]
            if spots:
                spot = min(spots, key=lambda s: math.hypot(s[0] - state.x, s[1] - state.y))
                return spot, math.hypot(spot[0] - state.x, spot[1] - state.y) < 2.0
        if state.plants:
            oldest = max(state.plants, key=lambda p: p[2])
            return (oldest[0], oldest[1]), False
        return (42, 46), False

    def _urgent(self, state, imp):
        """Whether an imp is near what it wants, and near enough to be met."""
        if imp["prey"] == "friend":
            near_prey = math.hypot(imp["x"] - state.friend_x, imp["y"] - state.friend_y) < 14
        else:
            near_prey = any(math.hypot(imp["x"] - p[0], imp["y"] - p[1]) < 8 for p in state.plants)
        return near_prey and math.hypot(imp["x"] - state.x, imp["y"] - state.y) < 24

    def _free(self, state, x, y):
        taken = [(p[0], p[1]) for p in state.plants] + [(a[0], a[1]) for a in state.ashes]
        if any(math.hypot(x - a, y - b) < 6.3 for a, b in taken):
            return False
        return all(math.hypot(x - a, y - b) > 8 for a, b in state.holes) and all(
            abs(x - a) > 9 or abs(y - b) > 7 for a, b in state.anvils
        )

    def _steer(self, state, x, y):
        want_x = 0.14 * (x - state.x) - 1.5 * state.vx
        want_y = 0.14 * (y - state.y) - 1.5 * state.vy
        for hx, hy in state.holes:
            dx, dy = state.x - hx, state.y - hy
            distance = math.hypot(dx, dy)
            if distance < 10:
                want_x += 0.5 * (10 - distance) * dx / max(distance, 0.1)
                want_y += 0.5 * (10 - distance) * dy / max(distance, 0.1)
        if max(abs(want_x), abs(want_y)) < 0.05:
            return 0
        if abs(want_x) > abs(want_y):
            return 4 if want_x > 0 else 3
        return 2 if want_y > 0 else 1
