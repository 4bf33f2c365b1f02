"""Avatars: what the player moves, and how it moves."""

from __future__ import annotations

from random import Random

from envcraft_composer.mechanic import Constants, Mechanic, scaled, traits

_STEPS = ((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (4, 0, 0))
_FIRST = ((0, 1, 0), (1, 1, 0), (2, 1, 0), (3, 1, 0), (4, 1, 0))
_PLAIN = "The four moves walk."

_SLIDE = """
for _ in range(1 if first else max(ROWS, COLUMNS)):
    self.at = self._shift(self.at, move)
    self._touch()
"""
_RUN = """
if move and self._shift(self.at, move) != self.at:
    self.heading = move
if not first:
    self.at = self._shift(self.at, self.heading)
"""
_TURTLE = """
if move == 3:
    self.facing = (self.facing + 3) % 4
elif move == 4:
    self.facing = (self.facing + 1) % 4
elif move == 1:
    self.at = self._shift(self.at, AROUND[self.facing])
"""
_HOP = """
if first and move:
    y, x = self.at[0] + 2 * MOVES[move][0], self.at[1] + 2 * MOVES[move][1]
    if 0 <= y < ROWS and 0 <= x < COLUMNS and (y, x) not in self.walls:
        self.at = (y, x)
else:
    self.at = self._shift(self.at, move)
"""
_KNIGHT = """
(y, x), (dy, dx) = self.at, MOVES[move]
leap = (y + 2 * dy + dx, x + 2 * dx - dy)
if not first:
    self.at = self._shift(self.at, move)
elif 0 <= leap[0] < ROWS and 0 <= leap[1] < COLUMNS and leap not in self.walls:
    self.at = leap
"""
_BLINK = """
opposite = (ROWS - 1 - self.at[0], COLUMNS - 1 - self.at[1])
if not first:
    self.at = self._shift(self.at, move)
elif opposite not in self.walls:
    self.at = opposite
"""
_SPRINT = """
self.stride = min(self.stride + 1, 3) if move and move == self.heading else 1
self.heading = move
for _ in range(self.stride):
    self.at = self._shift(self.at, move)
    self._touch()
"""
_SNAKE = """
after = self._shift(self.at, move)
if after in self.body[2:]:
    self.lost = True
elif after != self.at and after not in self.body[1:2]:
    self.at = after
    self.body = [after, *self.body][: GROW * (self.total - self._remaining()) + LENGTH]
"""
_JUMP = """
self.at, self.rise = self._leap(self.at, self.rise, move, first)
"""
_LEAP = '''
    def _leap(self, at: tuple[int, int], rise: int, move: int, first: int) -> tuple[tuple[int, int], int]:
        """The cell after a step, and how many cells the jump still rises."""
        if move in (3, 4):
            at = self._shift(at, move)
        stands = self._shift(at, 2) == at
        if stands and (move == 1 or first):
            rise = JUMP
        if rise:
            after = self._shift(at, 1)
            return (at, 0) if after == at else (after, rise - 1)
        return (at if stands else self._shift(at, 2)), 0
'''
_LEAPS = '''
    def _reachable(self) -> list[tuple[int, int]]:
        """The cells that jumps from the start can reach."""
        states = [(self.at, 0)]
        known = {states[0]}
        for at, rise in states:
            for move in (0, 1, 3, 4):
                after = self._leap(at, rise, move, 0)
                if after not in known:
                    known.add(after)
                    states.append(after)
        return list(dict.fromkeys(at for at, _ in states))
'''
_DRAW_NOSE = """
half = CELL // 2
y, x = (side + half + part * (half - 1) for side, part in zip(self._pixel(self.at), MOVES[{facing}]))
frame[y - 1 : y + 1, x - 1 : x + 1] = PALETTE[7]
"""
_DRAW_BODY = """
for place in self.body[1:]:
    self._blit(frame, place, BODY, PALETTE[3])
"""
_AIM = """
# With the button the avatar turns on the spot, so that it can look at a mark beside it.
self.facing = move or self.facing
self.at = self._shift(self.at, 0 if first else move)
self.beam = self._ray() if first and not self.reload else []
self.reload = RELOAD if self.beam else max(self.reload - 1, 0)
"""
_RAY = '''
    def _ray(self) -> list[tuple]:
        """The places ahead, up to the next wall."""
        found = [self.at]
        for _ in range(RANGE):
            found.append(self._shift(found[-1], self.facing))
        return list(dict.fromkeys(found))[1:]
'''
_SHIP = """
if move in (3, 4):
    self.facing = (self.facing + (1 if move == 4 else -1)) % 16
vy, vx = self.drift
if move == 1:
    angle = self.facing * np.pi / 8
    vy, vx = vy + THRUST * float(np.sin(angle)), vx + THRUST * float(np.cos(angle))
if move == 2:
    vy, vx = 0.6 * vy, 0.6 * vx
speed = max((vy * vy + vx * vx) ** 0.5, 1e-9)
slow = min(1.0, TOP_SPEED / speed)
self.drift = (vy * slow, vx * slow)
self.at = self._wrap(self.at[0] + self.drift[0], self.at[1] + self.drift[1])
self.beam = self._ray() if first and not self.reload else []
self.reload = RELOAD if self.beam else max(self.reload - 1, 0)
"""
_SHIP_RAY = '''
    def _ray(self) -> list[tuple]:
        """The points ahead, within range."""
        angle = self.facing * np.pi / 8
        dy, dx = 3 * float(np.sin(angle)), 3 * float(np.cos(angle))
        return [self._wrap(self.at[0] + dy * part, self.at[1] + dx * part) for part in range(1, RANGE)]
'''
_DRAW_SHIP = """
angle = self.facing * np.pi / 8
top, left = self._pixel(self.at)
half = CELL // 2
y, x = round(top + half + half * float(np.sin(angle))), round(left + half + half * float(np.cos(angle)))
frame[y - 1 : y + 1, x - 1 : x + 1] = PALETTE[4]
vy, vx = self.drift
y, x = round(min(max(top + half - 4 * vy, 6), 78)), round(min(max(left + half - 4 * vx, 1), 82))
frame[y : y + 2, x : x + 2] = PALETTE[3]
"""
_DRAW_BEAM = """
for top, left in map(self._pixel, self.beam):
    frame[top + CELL // 2, left + CELL // 2] = PALETTE[4]
frame[1:4, 60 : 60 + self.reload] = PALETTE[3]
"""
_FLY = """
for _ in range(2 if first else 1):
    self.at = self._shift(self.at, move)
"""
_PADDLE = """
self.paddle = min(max(self.paddle + (2 + 2 * first) * ((move == 4) - (move == 3)), 2), 82 - WIDTH)
y, x = self.at[0] + self.flight[0], self.at[1] + self.flight[1]
vy, vx = self.flight
if x < 1 or x > 83 - CELL:
    vx, x = -vx, min(max(x, 1.0), 83.0 - CELL)
if y < 6:
    vy, y = -vy, 6.0
if vy > 0 and y >= 73 - CELL:
    middle = x + CELL / 2 - self.paddle - WIDTH / 2
    if abs(middle) <= (WIDTH + CELL) / 2:
        vx = float(np.clip(vx + 0.12 * middle, -BALL, BALL))
        vy, y = -abs(vy), 73.0 - CELL
    elif y > 78 - CELL:
        self._harm()
        vy, vx, y, x = -abs(vy), 0.5, 40.0, 42.0
self.at, self.flight = (y, x), (vy, vx)
"""
_DRAW_PADDLE = """
frame[74:77, self.paddle : self.paddle + WIDTH] = PALETTE[3]
y, x = self._pixel(self.at)
vy, vx = self.flight
y, x = round(y + CELL // 2 - 2 * vy), round(min(max(x + CELL // 2 - 2 * vx, 1), 81))
frame[y : y + 2, x : x + 2] = PALETTE[3]
"""


def _pointed(facing: str) -> str:
    """Code that draws where the avatar looks."""
    return _DRAW_NOSE.replace("{facing}", facing)


def _snake(rng: Random, level: float) -> Constants:
    return {"LENGTH": rng.randint(3, 6), "GROW": 1}


def _jumper(rng: Random, level: float) -> Constants:
    return {"JUMP": 4}


def _shooter(rng: Random, level: float) -> Constants:
    return {"RANGE": rng.randint(4, 7), "RELOAD": rng.randint(3, 6)}


def _gunner(rng: Random, level: float) -> Constants:
    return {"RANGE": rng.randint(8, 14), "RELOAD": rng.randint(6, 12)}


def _ship(rng: Random, level: float) -> Constants:
    return {
        "THRUST": rng.choice((0.3, 0.4, 0.5)),
        "TOP_SPEED": rng.choice((2.5, 3.0)),
        "RANGE": rng.randint(7, 12),
        "RELOAD": rng.randint(6, 12),
    }


def _paddle(rng: Random, level: float) -> Constants:
    return {"WIDTH": scaled(18, 13, level) + rng.randint(0, 1), "BALL": rng.choice((2.0, 2.4)), "LOW": 56}


AVATARS = (
    Mechanic(
        "walker",
        "",
        gives=traits("mover", "pushes"),
        needs=traits("walk"),
        parts={"act": "self.at = self._shift(self.at, move)"},
        controls="The four moves walk one cell.",
        actions=_STEPS,
    ),
    Mechanic(
        "slider",
        "The ground is ice.",
        gives=traits("mover", "slides"),
        needs=traits("walk", "walled"),
        parts={"act": _SLIDE},
        controls="A move slides to the next wall and touches what is on the way. The first button makes it one cell.",
        actions=(*_STEPS, *_FIRST[1:]),
        pace=0.6,
    ),
    Mechanic(
        "runner",
        "",
        gives=traits("mover", "runs"),
        needs=traits("walk"),
        parts={"avatar": "self.heading = 0", "act": _RUN, "over": _pointed("self.heading")},
        controls="The avatar runs on by itself. A move turns it if the way is free. The first button stops it a step.",
        actions=(*_STEPS, _FIRST[0]),
        pace=1.1,
    ),
    Mechanic(
        "turtle",
        "",
        gives=traits("mover", "pushes", "turns"),
        needs=traits("walk"),
        parts={
            "constants": "# The moves in the order in which the avatar turns.\nAROUND = (1, 4, 2, 3)",
            "avatar": "self.facing = 0",
            "act": _TURTLE,
            "over": _pointed("AROUND[self.facing]"),
        },
        controls="Up walks ahead; left and right turn on the spot.",
        actions=((1, 0, 0), (3, 0, 0), (4, 0, 0), (0, 0, 0)),
        pace=1.7,
    ),
    Mechanic(
        "hopper",
        "",
        gives=traits("mover"),
        needs=traits("walk", "walled"),
        parts={"act": _HOP},
        controls="The four moves walk one cell. With the first button they hop two cells, over walls too.",
        actions=(*_STEPS, *_FIRST[1:]),
        pace=0.7,
    ),
    Mechanic(
        "knight",
        "",
        gives=traits("mover"),
        needs=traits("walk", "walled"),
        parts={"act": _KNIGHT},
        controls="The four moves walk one cell. With the first button they leap two cells ahead and one to the right.",
        actions=(*_STEPS, *_FIRST[1:]),
        pace=0.8,
    ),
    Mechanic(
        "blinker",
        "",
        gives=traits("mover"),
        needs=traits("walk"),
        # Between cars nobody could see where a blink is safe.
        bars=traits("traffic"),
        parts={"act": _BLINK},
        controls="The four moves walk one cell. The first button brings the avatar to the opposite side of the world.",
        actions=(*_STEPS, _FIRST[0]),
    ),
    Mechanic(
        "sprinter",
        "",
        gives=traits("mover", "pushes", "sprints"),
        needs=traits("walk"),
        parts={"avatar": "self.stride, self.heading = 1, 0", "act": _SPRINT},
        controls="The four moves walk one cell, the same move again two cells, and then three.",
        actions=_STEPS,
        pace=0.8,
    ),
    Mechanic(
        "snake",
        "The avatar is a snake that grows with every success. It dies when it bites itself.",
        gives=traits("mover", "long", "danger"),
        needs=traits("walk", "open"),
        parts={"avatar": "self.body = [self.at]", "act": _SNAKE, "draw": _DRAW_BODY},
        sprites=("BODY",),
        draw=_snake,
        controls="The four moves crawl one cell; the snake rests without a move.",
        actions=_STEPS,
    ),
    Mechanic(
        "jumper",
        "",
        gives=traits("mover"),
        needs=traits("side"),
        parts={
            "avatar": "self.rise = 0",
            "act": _JUMP,
            "method:leap": _LEAP,
            "method:reachable": _LEAPS,
            "over": "frame[1:4, 60 : 60 + 2 * self.rise] = PALETTE[3]",
        },
        draw=_jumper,
        controls="Left and right walk. Up or the first button jumps. The bar at the top shows how far it still rises.",
        actions=(*_STEPS, (3, 1, 0), (4, 1, 0)),
        pace=1.3,
    ),
    Mechanic(
        "marksman",
        "",
        gives=traits("mover", "aims"),
        needs=traits("walk"),
        parts={
            "avatar": "self.facing, self.reload, self.beam = 1, 0, []",
            "act": _AIM,
            "method:ray": _RAY,
            "over": _pointed("self.facing") + _DRAW_BEAM.lstrip(),
        },
        draw=_shooter,
        controls="The four moves walk and look that way. The first button turns on the spot and shoots, then reloads.",
        actions=(*_STEPS, *_FIRST),
    ),
    Mechanic(
        "flyer",
        "",
        gives=traits("mover"),
        needs=traits("plane"),
        parts={"act": _FLY},
        controls="The four moves fly; the first button doubles the speed.",
        actions=(*_STEPS, *_FIRST[1:]),
    ),
    Mechanic(
        "gunner",
        "",
        gives=traits("mover", "aims"),
        needs=traits("plane"),
        parts={
            "avatar": "self.facing, self.reload, self.beam = 1, 0, []",
            "act": _AIM,
            "method:ray": _RAY,
            "over": _pointed("self.facing") + _DRAW_BEAM.lstrip(),
        },
        draw=_gunner,
        controls="The four moves fly and aim that way. The first button turns on the spot and shoots, then reloads.",
        actions=(*_STEPS, *_FIRST),
    ),
    Mechanic(
        "ship",
        "The avatar is a ship that drifts. Dots show where it points and where it comes from.",
        gives=traits("mover", "aims", "drifts"),
        needs=traits("plane", "wrap"),
        parts={
            "avatar": "self.facing, self.drift, self.reload, self.beam = 0, (0.0, 0.0), 0, []",
            "act": _SHIP,
            "method:ray": _SHIP_RAY,
            "over": _DRAW_SHIP + _DRAW_BEAM.lstrip(),
        },
        draw=_ship,
        controls="Left and right turn, up thrusts, down brakes. The first button shoots ahead, then reloads.",
        actions=(*_STEPS, _FIRST[0], _FIRST[1]),
        pace=1.0,
    ),
    Mechanic(
        "paddle",
        "A ball bounces between the walls and off a paddle at the bottom; a dot shows where it comes from.",
        gives=traits("mover", "ball", "danger"),
        needs=traits("plane"),
        bars=traits("wrap"),
        parts={
            "avatar": "self.at, self.flight, self.paddle = (50.0, 40.0), (-2.0, self.np_random.uniform(-1.5, 1.5)), 34",
            "act": _PADDLE,
            "over": _DRAW_PADDLE,
        },
        draw=_paddle,
        controls="Left and right move the paddle, faster with the first button. The ball must not fall.",
        actions=((0, 0, 0), (3, 0, 0), (4, 0, 0), (3, 1, 0), (4, 1, 0)),
        pace=3.5,
    ),
)
