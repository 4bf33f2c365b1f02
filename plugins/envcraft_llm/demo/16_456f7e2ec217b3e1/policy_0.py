"""Looks a few pixels ahead: jumps trunks, gaps, heaps and phantoms, slides under beams, sidesteps falling shapes."""


class Policy:
    def act(self, state):
        x, speed = state.stage_x, state.speed
        # Back to the middle of the give, unless a shape is about to land there.
        move, jump = 3 if state.offset > 2 else 4 if state.offset < -2 else 0, 0
        if state.falling is not None:
            column, bottom, shape = state.falling
            left, right = column * 4 - 8, column * 4 + 4 * len(shape) + 2
            steps = (70 - bottom) / 1.5
            still = x - state.offset + speed * steps  # where no offset would bring it
            back, ahead = left - still, right - still  # offsets that are just clear of it
            if back < state.offset < ahead:
                choices = [goal for goal in (back, ahead) if -15 <= goal <= 15]
                if choices:
                    goal = min(choices, key=lambda offset: abs(offset - state.offset))
                    move = 3 if goal < state.offset else 4
            elif back < 0 < ahead:
                move = 0
        if not state.grounded:
            return [move, 0, 0]
        for kind, edge in sorted(state.obstacles, key=lambda entry: entry[1]):
            gap = edge - (x + 6)
            if kind == 1:
                if gap < 2.5 * speed and x < edge + 9:
                    return [2, 0, 0]
            elif -2 < gap < (1.0 if kind == 2 else 3.5) * speed + 1 + (3 if kind == 0 else 2):
                jump = 1
        for phantom, away in state.phantoms:
            if not away and 0 < phantom - x < 8 + 4 * speed:
                jump = 1
        if any(state.height_at(x + 3 + ahead) > state.height_at(x + 3) + 4 for ahead in range(1, 8)):
            jump = 1
        return [move, jump, 0]
