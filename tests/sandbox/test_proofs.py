"""A search through all states never says that a game which can be won was exhausted without a win."""

from __future__ import annotations

import socket

import pytest
from envcraft_protocol.jobs import Job
from envcraft_sandbox.worker import search
from envcraft_sandbox.worker.channel import Channel
from envcraft_sandbox.worker.subject import Subject
from envcraft_sandbox.worker.tree import Outcome, Tree

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.model.target import Target

#: A lock that a code opens; what is seen never changes.
LOCK = """
import random
import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle

CODE = [1, 1, 0, 1, 0, 0, 1, 1]
KEY, NOTHING = "the key", "empty hands"


class Lock(gym.Env{BASES}):
    def __init__(self):
        {INIT}
        self.observation_space = spaces.Discrete(2)
        self.action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.held = {ZERO}, NOTHING
        return 0, {{}}

    def step(self, action):
        won = {WON}
        self.at = self.at + 1 if int(self.at) < len(CODE) and action == CODE[int(self.at)] else {ZERO}
        self.held = KEY if self.at == len(CODE) else NOTHING
        return 0, float(won), bool(won), False, {{"is_success": bool(won)}}
"""
PLAIN = {"BASES": "", "INIT": "pass", "ZERO": "0", "WON": "self.at == len(CODE)"}
LOCKS = {
    "plain": {},
    "NumPy's numbers": {"ZERO": "np.int64(0)"},
    "numbers in lists": {"ZERO": "np.float32(0)"},
    "constants that are compared by identity": {"WON": "self.held is KEY and action"},
    "no win at all": {"WON": "False"},
    "copies that begin anew": {"BASES": ", EzPickle", "INIT": "EzPickle.__init__(self)"},
    "the generators that all code shares": {"WON": "np.random.random() < 1e-9"},
    "the library's generator": {"WON": "random.random() < 1e-9"},
    "its own space as a place": {
        "INIT": "self.box = spaces.Discrete(99)",
        "ZERO": "self._put(0)",
        "WON": "self.box.n == len(CODE)",
    },
}
#: What becomes of the state is put into a space.
PUT = """
    def _put(self, value):
        self.box.n = 1
        return value
"""


class Nobody(Channel):
    """A channel without a receiver."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_UNIX) as closed:
            super().__init__(closed)

    def _write(self, parts: list[bytes], size: int) -> None:
        pass


def exhaust(source: str, seed: int) -> Outcome:
    job: Job = {
        "kind": "search",
        "target": Target("lock.py", source.encode()).for_worker(),
        "search": "exhaust",
        "contract": GYMNASIUM.for_worker(),
        "seed": seed,
        "actions": [0, 1],
        "max_steps": 5_000,
        "limit": 200,
    }
    subject = Subject(job, Nobody())
    subject.load()
    tree = Tree(subject, job)
    search.exhaust(tree)
    return tree.out


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("changes", LOCKS.values(), ids=LOCKS)
def test_no_false_proof(changes: dict[str, str], seed: int) -> None:
    source = LOCK.format(**PLAIN | changes)
    if "_put" in source:
        source = source.replace("self.at + 1 if", "self._step() if") + PUT
        source += "\n    def _step(self):\n        self.box.n += 1\n        return self.at + 1\n"
    out = exhaust(source, seed)
    if changes == LOCKS["no win at all"]:
        assert (out.exhausted, out.states, out.win) == (True, 9, None)
    else:
        assert out.win is not None or not out.exhausted
    if changes in (LOCKS["plain"], LOCKS["NumPy's numbers"], LOCKS["constants that are compared by identity"]):
        assert out.win is not None
