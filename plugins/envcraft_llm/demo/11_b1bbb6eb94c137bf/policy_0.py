"""Push towards the nearest fish and brake in time."""

PUSH = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class Policy:
    def act(self, state):
        fish = min(state.fish, key=lambda f: abs(f["at"] - state.position).sum())
        gap = fish["at"] - state.position
        wanted = 0.08 * gap
        error = wanted - state.velocity
        axis = int(abs(error[1]) > abs(error[0]))
        if abs(error[axis]) < 0.1:
            return [0, 0, 0]
        return [(4 if error[0] > 0 else 3) if axis == 0 else (2 if error[1] > 0 else 1), 0, 0]
