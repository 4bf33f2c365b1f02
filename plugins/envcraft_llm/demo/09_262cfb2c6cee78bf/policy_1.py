"""Lift a flipper when the throw would meet a plant, or when the ball would slip through; nudge it out of the gap."""

import math

PIVOTS = ((22.0, 73.0), (62.0, 73.0))
LENGTH = 18.5
SWING = math.radians(28)
PLANTS = ((33.0, 27.0), (51.0, 27.0), (42.0, 38.0), (42.0, 17.0))


class Policy:
    def act(self, state):
        return [self._nudge(state), self._lift(state, 0), self._lift(state, 1)]

    def _lift(self, state, side):
        (px, py), way = PIVOTS[side], 1 if side == 0 else -1
        dx, dy = way * (state.x + state.vx - px), state.y + state.vy - py
        distance, angle = math.hypot(dx, dy), math.atan2(dy, dx)
        if state.lifted[side] or not 2 < distance < LENGTH + 1 or not -SWING < angle < SWING:
            return 0
        along = distance / LENGTH
        x, y = px + way * distance * 0.85, py - distance * 0.5
        last_chance = along > 0.88
        return int(last_chance or self._meets_plant(x, y, way * (2.2 - 2.4 * along), -4.0 * (0.7 + 0.35 * along)))

    @staticmethod
    def _meets_plant(x, y, vx, vy):
        for _ in range(30):
            vy += 0.11
            x, y = x + vx, y + vy
            if not 5 < x < 79:
                vx = -0.8 * vx
            if any(math.hypot(x - bx, y - by) < 6 for bx, by in PLANTS):
                return True
        return False

    @staticmethod
    def _nudge(state):
        recent = [step for step in state.nudged if state.steps + 1 - step < 100]
        if len(recent) >= 4 or state.tilt:
            return 0
        if state.y > 64 and 37 < state.x < 47 and state.vy > 0:
            return 3 if state.x < 42 else 4
        for bx, by, *_ in state.bullets:
            if not state.safe and abs(bx - state.x) < 4 and abs(by - state.y) < 4 and len(recent) < 3:
                return 4 if bx <= state.x else 3
        return 0
