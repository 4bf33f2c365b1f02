"""Use the line: turn to a fish that lies straight ahead within reach and hook it; otherwise line up with one."""


class Policy:
    def act(self, state):
        x, y = state.position
        slow = int(any(abs(shot[0] - x) < 16 and abs(shot[1] - y) < 6 for shot in state.shots))
        for fish in state.fish:
            dx, dy = fish["at"][0] - x, fish["at"][1] - y
            if abs(dy) < 3 and abs(dx) < 30:
                return [4 if dx > 0 else 3, 1, slow]
            if abs(dx) < 3 and abs(dy) < 30:
                return [2 if dy > 0 else 1, 1, slow]
        nearest = min(state.fish, key=lambda f: min(abs(f["at"][0] - x), abs(f["at"][1] - y)))
        dx, dy = nearest["at"][0] - x, nearest["at"][1] - y
        if abs(dx) < abs(dy):
            return [4 if dx > 0 else 3, 0, slow]
        return [2 if dy > 0 else 1, 0, slow]
