"""Shake the cat loose: hold each direction for a second in turn, hooking all the while, then chase the nearest fish."""


class Policy:
    def act(self, state):
        if not state.started:
            return [1 + state.steps // 30 % 4, state.steps % 2, 0]
        gap = min((fish["at"] - state.position for fish in state.fish), key=lambda g: abs(g).sum())
        wanted = gap / max(abs(gap).max(), 1.0) - state.velocity
        if abs(wanted[0]) > abs(wanted[1]):
            return [4 if wanted[0] > 0 else 3, 0, 1]
        return [2 if wanted[1] > 0 else 1, 0, 1]
