"""Code of the generated games with a ball: its serve, its flight and what it hits."""

from __future__ import annotations

SERVE = '''
def _serve(self) -> None:
    """Lay the ball on the paddle; the side to which it will fly is random."""
    self.held = True
    self.ball = [self.paddle + (PADDLE - BALL) // 2, FLOOR - BALL]
    self.velocity = [int(self.np_random.integers(-2, 3)), -1]
'''

FLY = '''
def _fly(self) -> None:
    """Move the ball a pixel at a time towards or away from the bricks, and to the side in step."""
    rise = <<rise>>
    for part in range(rise):
        self.ball[1] += self.velocity[1]
        across = self.velocity[0]
        self.ball[0] += across * (part + 1) // rise - across * part // rise
        if self.ball[0] <= 0 or self.ball[0] >= SIZE - BALL:
            self.ball[0] = max(0, min(SIZE - BALL, self.ball[0]))
            self.velocity[0] = abs(across) if self.ball[0] == 0 else -abs(across)
        if self.ball[1] <= CEILING or self._hit():
            self.velocity[1] = 1 if self.ball[1] <= CEILING else -self.velocity[1]
        middle = self.ball[0] + BALL // 2 - self.paddle
        if self.velocity[1] > 0 and self.ball[1] == FLOOR - BALL and -1 <= middle <= PADDLE:
            self.velocity[1] = -1
            <<aimed>>
    if self.ball[1] >= SIZE - BALL:
        self.lives -= 1
        self.lost = self.lives == 0
        self._serve()
'''

#: How the paddle changes the ball's course.
BOUNCE = {
    "offset": ("self.velocity[0] = max(-4, min(4, (2 * middle - PADDLE) * 5 // PADDLE))",),
    "english": (
        "# A resting paddle changes nothing.",
        "turn = (self.drift > 0) - (self.drift < 0)",
        "self.velocity[0] = max(-4, min(4, self.velocity[0] + 2 * turn))",
    ),
    "thirds": (
        "third = min(2, max(0, 3 * middle // PADDLE))",
        "self.velocity[0] = (-3, self.velocity[0] // 2, 3)[third]",
    ),
}

HIT = '''
def _hit(self) -> bool:
    """Damage the brick at the ball's middle, and return whether there is one."""
    row = (self.ball[1] + BALL // 2 - self.top) // HEIGHT
    column = (self.ball[0] + BALL // 2 - 2) // WIDTH
    if not (0 <= row < ROWS and 0 <= column < COLUMNS and self.bricks[row][column]) or self.won:
        return False
    self.bricks[row][column] -= 1
    if self.bricks[row][column] == 0:
        self.broken += 1
        <<broke>>
    return True
'''

DRAW = (
    """
    frame = BACKDROP.copy()
    for row, hits in enumerate(self.bricks):
        top = self.top + HEIGHT * row
        for column, left in enumerate(hits):
            if left:
                x = 2 + WIDTH * column
                frame[top : top + HEIGHT - 1, x : x + WIDTH - 1] = TOUGH if left > 1 else TILES[1]
    frame[FLOOR : FLOOR + 3, self.paddle : self.paddle + PADDLE] = PADDLE_COLOUR
    x, y = self.ball
    frame[y : y + BALL, x : x + BALL] = BALL_COLOUR
    # The dot behind the paddle shows to which side the ball flies, and the squares above count the balls.
    frame[82, SIZE // 2 + 4 * self.velocity[0]] = BALL_COLOUR
    for number in range(self.lives):
        frame[0:2, 2 + 4 * number : 5 + 4 * number] = BALL_COLOUR
    """,
)
