"""Go in only when there is time to come out again; dodge storks that are close."""


class Policy:
    def act(self, state):
        x, y = state.frog
        place = state.region(x, y)
        goal = self._goal_in(state, place) if place is not None else self._goal_out(state)
        return [self._towards(state, goal), 0, 0]

    def _goal_in(self, state, place):
        if state.flies[place] and not state.carrying:
            return state.flies[place]
        pair = next((pair for pair in (0, 1) if state.home(pair) == place), None)
        if pair is None:
            return state.frog
        return state.far[pair]

    def _goal_out(self, state):
        left = 100 - state.t % 100
        pairs = [pair for pair in (0, 1) if state.flies[state.home(pair)]]
        x, y = state.frog
        near = sorted(pairs, key=lambda pair: abs(self._island(pair)[0] - x) + abs(self._island(pair)[1] - y))
        for pair in near:
            ix, iy = self._island(pair)
            gap = abs(ix - x) + abs(iy - y)
            if gap / state.frog_speed + 45 / state.frog_speed + 20 < left:
                return ix, iy
        return 42.0, 66.0

    @staticmethod
    def _island(pair):
        return ((31.0, 44.0), (53.0, 44.0))[pair]

    def _towards(self, state, goal):
        x, y = state.frog
        speed = state.frog_speed
        best, choice = None, 0
        for move, (dx, dy) in enumerate(((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))):
            nx, ny = x + dx * speed, y + dy * speed
            if move and not state._free(nx, ny):
                continue
            gap = abs(goal[0] - nx) + abs(goal[1] - ny)
            danger = sum(max(0.0, 11 - max(abs(sx - nx), abs(sy - ny))) ** 2 for sx, sy, _ in state.storks)
            cost = gap + (0 if state.unhurt > 5 else 0.9 * danger)
            if best is None or cost < best:
                best, choice = cost, move
        return choice
