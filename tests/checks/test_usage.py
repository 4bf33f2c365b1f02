"""Which numbers of global generators the check lint leaves alone, because play uses nothing that is made of them."""

from __future__ import annotations

from string import Template

import pytest
from envcraft_checks.linting.generators import generators
from envcraft_checks.linting.program import Program

from envcraft.model.target import parse

GAME = Template("""
import copy, logging, os, random, uuid
import gymnasium as gym
import numpy as np
from helpers import Base, look
$top
LOG = logging.getLogger("game")

def halved(value):
    return value / 2

def state_of(game):
    return game.x

class Unit:
    def __init__(self, at=0): self.at = at
    def move(self):
        $move
    def where(self): return self.at

class Game($base):
    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.at = self.steps = 0
        self.unit = Unit()
        $made
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        $reset
        return self.see(), {}
    def step(self, action):
        self.steps += 1
        $step
        return self.see(), 0.0, self.steps > 9, False, {}
    def see(self):
        $see
    def render(self):
        return np.full(4, self.x)
    def keep(self, value, other=0):
        self.x = value
        self.log = [other]
    def seldom(self):
        return self.x if self.steps > 5 else 0
    @property
    def doubled(self):
        return 2 * self.x
    def draw(self):
        return random.random()
""")
USUAL = {
    "top": "",
    "base": "gym.Env",
    "made": "self.x = 0",
    "move": "pass",
    "reset": "pass",
    "step": "pass",
    "see": "return np.zeros(4)",
}
SHOWN = "return np.full(4, self.x)"


def reported(**parts: str) -> bool:
    """Whether lint reports a generator in a game of these statements."""
    return bool(list(generators(Program(parse(GAME.substitute(USUAL | parts).encode())))))


@pytest.mark.parametrize(
    "parts",
    [
        {"made": "self.x = uuid.uuid4()"},
        {"made": "self.x = os.getpid()"},
        {"made": "self.x = os.urandom(4).hex()"},
        {"made": "self.x = f'run-{uuid.uuid4().hex[:8]}'", "step": "LOG.info('%s: %d', self.x, self.steps)"},
        {"made": "self.x = uuid.uuid4(); self.path = os.path.join('runs', str(self.x))"},
        {"made": "self.x = [random.random() for _ in range(3)]"},
        {"made": "self.x = random.choice(['a', 'b'])", "step": "if self.render_mode == 'human': look(self.x)"},
        {"made": "self.x = np.random.rand(2)", "reset": "self.x = self.np_random.random(2)", "see": SHOWN},
        {"made": "self.r = random.Random()", "reset": "self.colour = self.r.random()"},
        {"made": "self.r = np.random.default_rng(3)", "reset": "self.colour = self.r.random()"},
        {"made": "self.reset(seed=random.randrange(9))"},
        {"reset": "self.x = random.random()", "step": "self.x += 1; self.x = 2 * self.x"},
        {"step": "random.random()"},
        {"step": "_ = random.random()"},
        {"step": "angle = random.random(); speed = 2 * angle"},
        {"step": "print(random.random())"},
        {"step": "if random.random() < 0.1: LOG.debug('still here')"},
        {"step": "self.x = halved(random.random())"},
        {"step": "self.keep(random.random())"},
        {"step": "self.keep(0, other=random.random())"},
        {"step": "self.x = self.draw()"},
        {"step": "self.x = self.action_space.sample()"},
        {"made": "self.y = []", "step": "self.y.append(random.random())"},
        {"made": "self.y = np.zeros(4)", "step": "self.y[self.steps] = random.random()"},
        {"step": "self.x, self.y = random.random(), 1"},
        {"step": "(x := random.random())"},
        {"top": "RUN = uuid.uuid4()", "step": "LOG.debug('%s', RUN)"},
        {"top": "RUN = uuid.uuid4()\nNAME = str(RUN)", "step": "LOG.debug('%s', NAME)"},
        {"move": "self.colour = random.random()", "step": "self.unit.move()"},
    ],
)
def test_a_number_that_play_does_not_use_is_accepted(parts: dict[str, str]) -> None:
    assert not reported(**parts)


@pytest.mark.parametrize(
    "parts",
    [
        {"made": "self.x = random.random()", "see": SHOWN},
        {"made": "x = random.random(); self.x = [x]", "see": SHOWN},
        {"made": "self.x = uuid.uuid4().int % 9", "see": SHOWN},
        {"made": "self.x = random.random()", "step": "self.at += self.seldom()", "see": "return np.array([self.at])"},
        {"made": "self.x = random.random()", "step": "if self.doubled > 1: self.at = 2"},
        {"made": "self.x = random.random()", "step": "while self.at < self.x: self.at += 1"},
        {"made": "self.x = random.randrange(9)", "step": "for _ in range(self.x): self.at += 1"},
        {"made": "self.x = random.random()", "see": "return np.full(4, state_of(self))"},
        {"made": "self.x = random.random()", "see": "return look(self)"},
        {"made": "self.x = random.random()", "see": "return np.full(4, getattr(self, 'x'))"},
        {"made": "self.x = random.random()", "see": "return np.array(list(vars(self).values())[:2])"},
        {"made": "self.x = random.random()", "base": "Base"},
        {"made": "self.action_space = gym.spaces.Discrete(random.randrange(2, 9))"},
        {"made": "if random.random() < 0.5: self.at = 2"},
        {"made": "self.x = np.random.rand(2)", "reset": "self.keep(self.x); self.x = 0", "see": SHOWN},
        {"made": "self.r = random.Random()", "step": "self.at = self.r.random()", "see": "return np.array([self.at])"},
        {"made": "self.r = random.Random(); self.deck = [1, 2]", "reset": "self.r.shuffle(self.deck)"},
        {"made": "self.deck = [1, 2]", "reset": "random.shuffle(self.deck)"},
        {"made": "self.x = []", "step": "self.x.append(random.random())", "see": SHOWN},
        {"made": "self.x = []; self.y = self.x", "step": "self.y.append(random.random())", "see": SHOWN},
        {"made": "self.x = np.zeros(4)", "step": "self.x[random.randrange(4)] = 1", "see": SHOWN},
        {"made": "self.x = np.zeros(4)", "step": "x = self.x; x[0] = random.random()", "see": SHOWN},
        {"step": "self.unit.at = random.random()"},
        {"step": "self.unit = Unit(random.random())"},
        {"move": "self.at = random.random()", "step": "self.unit.move()", "see": "return np.array([self.unit.at])"},
        {"move": "self.at = random.random()", "step": "self.unit.move(); self.at = self.unit.where()"},
        {"step": "return np.zeros(4), random.random(), False, False, {}"},
        {"step": "return np.zeros(4), 0.0, False, False, {'id': uuid.uuid4().hex}"},
        {"step": "random.random() < 0.5 and self.keep(1)"},
        {"step": "[self.keep(1) for _ in range(random.randrange(3))]"},
        {"step": "global LUCK; LUCK = random.random()"},
        {"step": "look(random.random())"},
        {"step": "np.copyto(self.x, random.random())"},
        {"step": "random.seed(os.getpid())"},
        {"step": "self.x = halved(random.random())", "see": SHOWN},
        {"step": "self.x = halved(self.draw())", "see": SHOWN},
        {"step": "self.keep(other=1, value=random.random())", "see": SHOWN},
        {"step": "self.keep(*[random.random()])", "see": SHOWN},
        {"step": "self.x = self.action_space.sample()", "see": SHOWN},
        {"step": "match random.choice('ab'):\n            case 'a': self.at = 1"},
        {"step": "self.x = sorted([1, 2], key=lambda one: random.random())", "see": SHOWN},
        {"top": "LUCK = random.random()", "see": "return np.full(4, LUCK)"},
        {"top": "LUCK = random.random()\nHALF = LUCK / 2", "see": "return np.full(4, HALF + LUCK)"},
        {"top": "RNG = np.random.default_rng(0)", "see": "return RNG.random(4)"},
    ],
)
def test_a_number_that_play_may_use_is_reported(parts: dict[str, str]) -> None:
    assert reported(**parts)
