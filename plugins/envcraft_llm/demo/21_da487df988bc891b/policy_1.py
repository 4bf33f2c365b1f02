"""Lays a plank towards the pin whenever the electron stands on the bank, and slides in its direction."""


class Policy:
    def act(self, state):
        if state.heading:
            return [0, 0, 0]
        x, y = state.position
        px, py = state.pin
        if x == 6 and y == py:
            # On the bank in the pin's row: bridge the channel, then cross it.
            if y in state.planks:
                return [4, 0, 0]
            return [0, 1, 0]
        if y != py:
            return [2 if py > y else 1, 0, 0]
        return [4 if px > x else 3, 0, 0]
