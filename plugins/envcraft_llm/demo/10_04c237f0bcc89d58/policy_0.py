"""Meet the puck in front of the goal, hold it, shoot past the cloud."""


class Policy:
    def act(self, state):
        mx, my = state.mallet
        px, py = state.puck
        vx, vy = state.speed
        if state.holding:
            return self._shoot(state)
        near = abs(px - mx) < 7 and abs(py - my) < 7
        goal_x, goal_y = self._meet(px, py, vx, vy, mx, my)
        return [self._towards(mx, my, goal_x, goal_y), int(near and state.hold_left > 0), 0]

    @staticmethod
    def _meet(px, py, vx, vy, mx, my):
        """Where to stand: on the puck's way while it comes down, behind it while it lies still."""
        if vy > 0.4:
            line = max(py, 66.0)
            across = px + vx / vy * (line - py)
            across = across if 8 < across < 75 else 42.0
            return across, line
        if py > 46 and vx * vx + vy * vy < 4:
            return px, py + 6
        return 42.0, 72.0

    @staticmethod
    def _towards(mx, my, x, y):
        if abs(x - mx) >= abs(y - my) and abs(x - mx) > 1:
            return 4 if x > mx else 3
        if abs(y - my) > 1:
            return 2 if y > my else 1
        return 0

    @staticmethod
    def _shoot(state):
        """Carry the puck towards the side that the cloud leaves open; let go when a shot will pass it."""
        mx, my = state.mallet
        flight = (my - 8) / 3.2
        best, choice = 0.0, None
        for move, turn in ((0, 0.0), (3, -1.6), (4, 1.6)):
            arrival = mx + 0.8 * turn * flight
            if 33 < arrival < 51 and abs(arrival - state.cloud[0]) > best:
                best, choice = abs(arrival - state.cloud[0]), move
        if choice is not None and (best > 8.5 or state.hold_left <= 1):
            return [choice, 0, 0]
        corner = 33.5 if state.cloud[0] >= 42 else 50.5
        return [4 if mx < corner else 3, 1, 0]
