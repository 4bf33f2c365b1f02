"""Blasts a way to the pin with charges: lays one, backs off, waits for it to go off, and goes on."""


class Policy:
    def __init__(self):
        self.waiting = 0

    def act(self, state):
        if state.heading:
            return [0, 0, 0]
        if self.waiting > 0:
            self.waiting -= 1
            return [0, 0, 0]
        if state.charges:
            # Away from the charge, along the way with more room.
            self.waiting = 22
            return [1 if state.position[1] > 5 else 2, 0, 0]
        if state.steps < 60:
            return [0, 0, 1]
        return [0, 0, 0]
