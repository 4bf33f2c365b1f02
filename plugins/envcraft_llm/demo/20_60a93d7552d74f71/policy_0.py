"""Goes where the ball or the next berry comes down, keeps clear of seals and empties the basket in between."""


class Policy:
    def act(self, state):
        middle = state.x + 3
        target = self.target(state, middle)
        for seal in state.falling:
            x = state.fall_x(seal)
            if seal[3] and 52 < seal[1] < 73 and abs(x - target) < 9:
                target = x + 10 if (middle > x and x < 70) or x < 22 else x - 10
        for x, _ in state.crawling:
            if abs(x - middle) < 12:
                target = middle + (14 if middle > x else -14)
        if abs(target - middle) < 1.5:
            return [0, 0, 0]
        return [4 if target > middle else 3, 1 if abs(target - middle) > 12 else 0, 0]

    def landing(self, state):
        """Where and in how many steps the ball comes down to the skater's height."""
        (x, y), (vx, vy) = state.ball, state.ball_v
        for steps in range(1, 120):
            x, y = x + vx, y + vy
            if not 13 < x < 82:
                vx = -vx
            if vy < 0 and y < 26:
                vy = -vy
            if y > 65 and vy > 0:
                return x, steps
        return 48.0, 120

    def target(self, state, middle):
        ball_x, ball_steps = self.landing(state)
        jobs = [(ball_steps, ball_x)]
        for thing in state.falling:
            if not thing[3]:
                steps = (66 - thing[1]) / 0.9
                if steps > -6:
                    jobs.append((max(steps, 0), state.fall_x(thing)))
        jobs.sort()
        if ball_steps < 14 or (ball_steps < 25 and abs(ball_x - middle) > 20):
            return ball_x
        enough = state.basket + state.shelf >= 18
        if state.basket >= 4 or enough:
            time = (middle - 5) / 2.5 + 4
            if enough or jobs[0][0] > time + abs(jobs[0][1]) / 2.5 or state.basket >= 5:
                if ball_steps > time + ball_x / 2.5:
                    return 4.0
        for steps, x in jobs:
            if abs(x - middle) / 2.5 < steps + 4:
                return x
        return ball_x
