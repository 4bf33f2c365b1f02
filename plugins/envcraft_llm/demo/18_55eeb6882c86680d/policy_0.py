"""Steers from passage to passage to the solar cell. The way point is kept on the state between calls."""

TOP, MIDDLE, BOTTOM = 0, 1, 2
MIDDLES = {TOP: 21.0, MIDDLE: 47.0, BOTTOM: 68.0}


class Policy:
    def lane(self, y):
        return TOP if y < 35 else MIDDLE if y < 59 else BOTTOM

    def act(self, state):
        x, y = state.x, state.y
        here, there = self.lane(y), self.lane(state.cell[1])
        goal_x, goal_y = state.cell
        if here != there:
            # From the top one goes down on the right, from the middle one on the left.
            to_right = TOP in (here, MIDDLE if here == BOTTOM else there) and BOTTOM != here
            opening = max(53.0, min(66.0, 80 - state.inset)) if to_right else min(31.0, max(18.0, 4 + state.inset))
            goal_x = opening
            clear = x > 49 if to_right else x < 35
            goal_y = MIDDLES[here] if not clear else MIDDLES[here + (1 if there > here else -1)]
        state.way_point = (goal_x, goal_y)
        edge = state.inset + 5
        goal_y = min(max(goal_y, edge), 84 - edge)
        goal_x = min(max(goal_x, edge), 84 - edge)
        ray = 0
        for shard in state.shards:
            ahead = (shard[0] - x) * state.facing
            if not shard[4] and 0 < ahead <= 15 and abs(shard[1] - y) < 5:
                ray = 1
        wanted = min(max(0.12 * (goal_y - y), -1.2), 1.2)
        error = wanted - state.vy
        if abs(error) > 0.25 or abs(goal_x - x) < 2:
            move = 2 if error > 0.05 else 1 if error < -0.05 else 0
        else:
            move = 4 if goal_x > x else 3
        return [move, ray, 0]
