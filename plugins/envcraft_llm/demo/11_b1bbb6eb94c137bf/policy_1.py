"""Drift towards fish of the chain's colour, slow the world while a shot is near, bounce off nothing."""


class Policy:
    def act(self, state):
        fish = min(state.fish, key=lambda f: self._cost(state, f))
        x, y = state.position
        vx, vy = state.velocity
        ahead_x, ahead_y = x + 6 * vx, y + 6 * vy
        danger = any(abs(shot[0] - x) < 20 and abs(shot[1] - y) < 6 for shot in state.shots)
        if not 10 < ahead_x < 74:
            return [4 if vx < 0 else 3, 0, int(danger)]
        if not 10 < ahead_y < 74:
            return [2 if vy < 0 else 1, 0, int(danger)]
        dx, dy = fish["at"][0] - ahead_x, fish["at"][1] - ahead_y
        if abs(dx) > abs(dy):
            return [4 if dx > 0 else 3, 0, int(danger)]
        return [2 if dy > 0 else 1, 0, int(danger)]

    @staticmethod
    def _cost(state, fish):
        cost = abs(fish["at"] - state.position).sum()
        return cost - 15 if fish["colour"] == state.chain_colour else cost
