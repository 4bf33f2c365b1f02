"""Gathers the letters of the room it is in, then trades through the window into the next room to the right."""

FLOOR, LOW, HIGH = 78, 66, 54


class Policy:
    def act(self, state):
        room = state.room_of(state.x)
        letters = [letter for letter in state.letters if state.room_of(letter[0]) == room]
        if letters:
            x, y = min(letters, key=lambda spot: (abs(spot[1] + 4 - state.y), abs(spot[0] - state.x)))
            return self.go(state, x - 1, y + 4)
        if state.facing > 0 and state.cooldown == 0:
            seen = [thing for thing in state.things if state.sees(thing)]
            if seen:
                nearest = min(seen, key=lambda thing: abs(thing[1] - state.x))
                if state.room_of(nearest[1]) > room:
                    return [0, 1, 0]
        if state.windows[min(room, 1)][1] == FLOOR:
            # As far right as the room allows, where no wolf comes between.
            return self.go(state, state.x + 4, FLOOR)
        left, right, _ = state.ledges[room]
        action = self.go(state, (left + right) // 2 - 2, LOW)
        return [4, 0, 0] if action == [0, 0, 0] and state.facing < 0 else action

    def go(self, state, x, level):
        """Walk to x on one of the three levels."""
        if not state.grounded:
            return [0, 0, 0]
        if state.y < level - 1:
            return [2, 0, 0]
        if state.y > level + 1:
            room = state.room_of(state.x)
            above = LOW if state.y > LOW + 1 else HIGH
            left, right, _ = next(
                one for one in state.ledges if one[2] == above and state.room_of((one[0] + one[1]) / 2) == room
            )
            middle = (left + right) // 2 - 2
            if above == HIGH:  # stay above the low ledge while walking below the high one
                low = state.ledges[room]
                middle = min(max(middle, low[0] - 2), low[1] - 3)
            if abs(state.x - middle) <= 2:
                return [1, 0, 0]
            return [4 if middle > state.x else 3, 0, 0]
        if abs(state.x - x) <= 1:
            return [0, 0, 0]
        return [4 if x > state.x else 3, 0, 0]
