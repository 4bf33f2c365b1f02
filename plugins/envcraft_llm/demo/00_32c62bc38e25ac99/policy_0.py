"""Guard the duct with one tower, climb over the ridge, settle on the narrow pad."""


class Policy:
    def act(self, state):
        tower = int(state.steps == 0)
        legs = int(not state.legs_wanted and not state.leg_button_held)
        left, width = state.narrow_pad
        gap = left + width / 2 - state.x
        wanted_vx = max(-0.6, min(0.6, 0.05 * gap))
        over_pad = abs(gap) < 5
        cruise = min(state.ridge_top - 14, 34)
        if over_pad:
            height = 70 - state.y
            wanted_vy = 0.6 if height > 10 else 0.35
        else:
            wanted_vy = max(-0.6, min(0.5, 0.06 * (cruise - state.y)))
        error = wanted_vx - state.vx
        low = over_pad and state.y > 60
        limit = 0.25 if low else 0.08
        lean = 0
        if error > limit:
            lean = 20 if error < 0.3 or low else 40
        elif error < -limit:
            lean = -20 if error > -0.3 or low else -40
        if over_pad and state.y > 66:
            lean = 0
        if state.angle < lean:
            return [4, legs, tower]
        if state.angle > lean:
            return [3, legs, tower]
        return [1 if state.vy > wanted_vy else 0, legs, tower]
