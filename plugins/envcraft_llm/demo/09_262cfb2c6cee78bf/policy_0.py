"""Lift the flipper that the ball is falling towards; nudge it away from the gap."""


class Policy:
    def act(self, state):
        nudge = 0
        if state.ball_y > 64 and 37 < state.ball_x < 47 and len(state.nudges) < 3:
            nudge = 3 if state.ball_x < 42 else 4
        low = state.ball_y > 66 and state.ball_vy > 0
        return [nudge, int(low and state.ball_x < 42), int(low and state.ball_x >= 42)]
