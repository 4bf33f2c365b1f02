"""Looks ahead from wherever the submersible clings: tries kicks and drops with a few ways of steering, takes the best."""

import itertools

LEFT, RIGHT, SHIP = 24, 60, 19.5
GRAVITY, CROSSING, STEER, SINK = 0.09, 1.6, 0.25, 1.4
KICK = (2 * GRAVITY * 18) ** 0.5


class Policy:
    def __init__(self):
        self.plan = []

    def act(self, state):
        if state.changing:
            self.plan = []
            return [0, 0, 0]
        goal = self.goal(state)
        if goal == "resize":
            return [0, 0, 0 if state.button_was[1] else 1]
        if not self.plan or (state.side and self.plan[0] in (3, 4)):
            self.plan = self.best(state, goal)
        return [self.plan.pop(0) if self.plan else 0, 0, 0]

    def goal(self, state):
        """The wall and the height to go to; wall 0 is the ship."""
        left = 5 - state.delivered - state.carrying
        home = (0, 12.0)
        if state.carrying == 2 or (state.carrying and not left):
            target = home
        else:
            easy = [nodule for nodule in state.nodules if not nodule[2]]
            if not easy and state.size == 10:
                return "resize"
            pick = min(easy or state.nodules, key=lambda nodule: abs(nodule[1] + 4 - state.y))
            target = (pick[0], pick[1] + 4)
        way = abs(state.y - target[1]) + (target[1] - 14 if target[0] else 0)
        if state.breath < 25 + 1.6 * way:
            vents = [(vent[0], vent[1] + 4) for vent in state.vents if vent[2] == 0]
            if state.breath < 90 and vents:
                near = min(vents, key=lambda vent: abs(vent[1] - state.y))
                if abs(near[1] - state.y) < state.y - 14:
                    return near
            if state.breath < 90:
                return home
        return target

    def best(self, state, goal):
        firsts = (1, 2, 0) if state.side else (0,)
        plans = [[0] * 6] if state.side else []
        for first, one, turn, two in itertools.product(firsts, (0, 3, 4), (4, 10, 16, 24), (0, 3, 4)):
            if first or not state.side:
                plans.append([first] + [one] * turn + [two] * (50 - turn))
        scored = [(*self.score(state, plan, goal), plan) for plan in plans]
        value, length, plan = max(scored, key=lambda entry: entry[0])
        return plan[:length]

    def beside(self, side, y, thing, reach):
        return side == thing[0] and abs(y - thing[1]) <= reach

    def score(self, state, plan, goal):
        x, y, vx, vy, side, steps = state.x, state.y, state.vx, state.vy, state.side, state.steps
        half = state.size / 2
        cost, best = 0.0, None
        for count, move in enumerate(plan, 1):
            steps += 1
            if side:
                y += steps % 2 == 0
                if move == 1:
                    vx, vy, side = -side * CROSSING, -KICK, 0
                elif move == 2:
                    vx, vy, side = -side * 0.4, 0.4, 0
            else:
                if move in (3, 4):
                    vx = min(max(vx + STEER * (1 if move == 4 else -1), -CROSSING), CROSSING)
                vy = min(vy + GRAVITY, SINK)
                x, y = x + vx, y + vy
                if x <= LEFT + half and vx < 0:
                    side = -1
                elif x >= RIGHT - half and vx > 0:
                    side = 1
            x = min(max(x, LEFT + half), RIGHT - half)
            if y > 80 - half:
                y, vy = 80 - half, 0.0
            if y < 10 + half:
                y, vy = 10 + half, max(vy, 0.0)
            if any(self.beside(side, y, (s, t + 4), half + 3) for s, t in state.spikes):
                cost += 60
            for fish in state.fish:
                near = abs(fish[0] - x) < half + 5 and abs(fish[1] - y) < half + 4
                if near and not (fish[3] == 1 and state.size == 10):
                    cost += 8
            done = y < SHIP if goal[0] == 0 else self.beside(side, y, goal, half + 1)
            if done:
                return 500 - count - cost, count
            if side and count > 1 and best is None and plan[0]:
                best = count
                break
        length = best or len(plan)
        wrong = 12 if goal[0] and side != goal[0] else 0
        return -abs(y - goal[1]) - wrong - cost - 0.15 * length, length
