"""Go to the string of the next dot, and open its gate when a star waits there."""


class Policy:
    def act(self, state):
        wanted = state.song[state.lit]
        underway = any(x > state.gates[n] - 2 for n in range(4) for x in state.stars[n])
        if underway and state.string == wanted:
            # Until the star that is on its way has rung, the next dot is not known to be next.
            return [0, 0, 0]
        if state.string < wanted:
            return [2, 0, 0]
        if state.string > wanted:
            return [1, 0, 0]
        gate = state.gates[wanted]
        waiting = [x for x in state.stars[wanted] if x <= gate - 3]
        ready = bool(waiting) and waiting[0] >= gate - 6
        press = ready and not underway and not state.open_for[wanted] and not state.pressed
        return [0, int(press), 0]
