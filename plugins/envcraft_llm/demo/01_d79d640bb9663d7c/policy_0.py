"""Take the errands in order, one circle at a time: an emitter, a key, the next room."""

from math import atan2, cos, hypot, pi, sin

DOORS = (28, 56)
REACH = 14.0


class Policy:
    def act(self, state):
        dash = int(self._row_near(state) and not state.rest)
        if state.anchor is None:
            return [0, 0, dash]
        target = self._target(state)
        anchor = min(range(7), key=lambda n: self._cost(state, n, target))
        if self._room(state.x) != self._room(target[0]):
            door = DOORS[min(self._room(state.x), self._room(target[0]))]
            anchor = self._through(state, door, self._room(target[0]))
        if anchor == state.anchor:
            return [self._careful(state, self._circle(state, target)), 0, dash]
        return self._hop(state, anchor, dash)

    def _row_near(self, state):
        if state.row_y is None:
            return False
        heading = self._heading(state)
        ahead = state.row_y - state.y
        return -7 < ahead < -1 and sin(heading) < -0.5 or -1 <= ahead < 1

    @staticmethod
    def _heading(state):
        if state.anchor is None:
            return atan2(state.vy, state.vx)
        return state.angle + state.sense * pi / 2

    @staticmethod
    def _room(x):
        return sum(x > door for door in DOORS)

    def _target(self, state):
        """The next errand: lit emitters of this room first, then the key, then the room behind the door."""
        room = self._room(state.x)
        on = [e["pos"] for e in state.emitters if e["on"]]
        here = [pos for pos in on if self._room(pos[0]) == room]
        if here:
            return min(here, key=lambda pos: hypot(pos[0] - state.x, pos[1] - state.y))
        goal = min((pos for pos in on), key=lambda pos: abs(self._room(pos[0]) - room))
        door = min(room, self._room(goal[0]))
        if state.carried != door and not state.door_timer[door] and door in state.door_keys:
            if self._room(state.door_keys[door][0]) == room:
                return state.door_keys[door]
        return goal

    def _cost(self, state, number, target):
        ax, ay = state.anchors[number]
        gap = hypot(ax - target[0], ay - target[1])
        if self._room(ax) != self._room(target[0]):
            return 1000 + gap
        stay = 0 if number == state.anchor else 4
        return stay + max(0.0, gap - REACH) * 10 + abs(gap - 10)

    def _through(self, state, door, room):
        """The anchor on the other side that is easiest to fly to."""
        step = 1 if room > self._room(state.x) else -1
        wanted = self._room(state.x) + step
        ax, ay = state.anchors[state.anchor]
        others = [n for n, (x, _) in enumerate(state.anchors) if self._room(x) == wanted]
        return min(others, key=lambda n: abs(state.anchors[n][1] - ay))

    def _circle(self, state, target):
        ax, ay = state.anchors[state.anchor]
        wanted = min(max(hypot(target[0] - ax, target[1] - ay), 6), 15)
        if state.radius < wanted - 0.6:
            return 1
        if state.radius > wanted + 0.6:
            return 2
        return 0

    def _hop(self, state, anchor, dash):
        """Let go when the straight line ahead meets the wanted anchor's catch first; meanwhile circle closely."""
        heading = self._heading(state)
        if self._first_caught(state, heading) == anchor:
            return [0, 1, dash]
        return [self._careful(state, 2 if state.radius > 9 else 0), 0, dash]

    def _careful(self, state, wanted):
        """The wanted move, unless a drone will be met on the way; then the move that meets it latest."""
        turn = 4 if state.sense < 0 else 3
        return max((wanted, 0, 1, 2, turn), key=lambda move: self._meets(state, move))

    @staticmethod
    def _meets(state, move):
        ax, ay = state.anchors[state.anchor]
        radius, sense, angle = state.radius, state.sense, state.angle
        for step in range(1, 9):
            if move in (1, 2):
                radius = min(max(radius + (1 if move == 1 else -1), 5), 16) if step < 4 else radius
            elif move:
                sense = 1 if move == 4 else -1
            angle += sense * pi / 18
            x, y = ax + radius * cos(angle), ay + radius * sin(angle)
            if any(hypot(dx - x, dy + step * pace - y) < 4 for dx, dy, pace in state.drones):
                return step
            if state.row_y is not None and abs(state.row_y + 0.8 * step - y) < 3 and state.rest:
                return step
        return 9

    def _first_caught(self, state, heading):
        x, y, left = state.x, state.y, state.anchor
        dx, dy = 2 * cos(heading), 2 * sin(heading)
        for _ in range(40):
            if not (2 <= x + dx <= 81 and 8 <= y + dy <= 81):
                return None
            for number, door in enumerate(DOORS):
                if (x - door) * (x + dx - door) <= 0 and not state.door_timer[number] and state.carried != number:
                    return None
            x, y = x + dx, y + dy
            for number, (ax, ay) in enumerate(state.anchors):
                if number != left and hypot(x - ax, y - ay) <= 14 and self._room(x) == self._room(ax):
                    return number
        return None
