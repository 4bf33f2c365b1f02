"""Keep the balloon up, hold the load into the arc of a shell, and stack in the time between."""

SIZES = {"skull": (12, 7), "rib cage": (16, 6), "femur": (14, 5), "egg": (10, 7)}


class Policy:
    def act(self, state):
        if state.balloon > 40:
            return self._bump(state)
        if state.target is not None and state.load is not None:
            shield = self._shield(state)
            if shield is not None:
                return [shield, 0, 0]
        if state.load is None:
            return self._bump(state) if state.balloon > 30 else [self._go(state, 44, 22), 0, 0]
        top = 76 - state.height()
        x = state.stack[-1][0] + state.sway_at(state.height()) if state.stack else 26
        width, height = SIZES[state.load]
        y = max(14, min(58, top - height - 8))
        move = self._go(state, x, y)
        aligned = abs(state.trolley - x) <= 2 and abs(state.hook - y) <= 4
        wanted = state.height() < 36
        return [0 if aligned else move, int(aligned and wanted), 0]

    def _bump(self, state):
        """Come up under the balloon."""
        under = min(58, state.balloon + 4)
        if abs(state.trolley - 60) > 3:
            if state.hook < state.balloon + 3 and state.hook < 56:
                return [2, 0, 0]
            return [4 if state.trolley < 60 else 3, 0, 0]
        return [1 if state.hook > under else 2, 0, 0]

    def _shield(self, state):
        """The way to a point of the arc that the load can reach before the shell does."""
        _, height = SIZES[state.load]
        flown = (state.flight or 0) - (state.countdown if state.flight is None else 0)
        best = None
        for k in range(5, 23):
            x, y = state.arc_point(k / 24)
            hook = y - 4 - height / 2
            if not (8 <= x <= 76 and 14 <= hook <= 58):
                continue
            need = (abs(x - state.trolley) + abs(hook - state.hook)) / 2
            if need <= k - flown + 1 and (best is None or need < best[0]):
                best = (need, x, hook)
        if best is None:
            return None
        return self._go(state, best[1], best[2])

    def _go(self, state, x, y):
        dx, dy = x - state.trolley, y - state.hook
        if abs(dx) < 1.5 and abs(dy) < 1.5:
            return 0
        if dy < -2 and abs(dx) > 4:
            return 1
        if abs(dx) >= 1.5:
            return 4 if dx > 0 else 3
        return 2 if dy > 0 else 1
