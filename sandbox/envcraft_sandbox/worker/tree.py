"""Branches of one seeded episode, which the searches grow, and what these find."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xxhash
from envcraft_protocol.jobs import Job

from .channel import encode_value, jsonable
from .copies import Copies
from .subject import Fault, Subject

_Random = random.Random
_monotonic = time.monotonic
_hash: Any = xxhash.xxh3_64_intdigest


@dataclass(slots=True)
class Path:
    """Actions as a linked list: branches share what led to them."""

    parent: Path | None
    action: Any
    length: int

    def then(self, action: Any) -> Path:
        return Path(self, action, self.length + 1)

    def actions(self) -> list[Any]:
        found, node = [], self
        while node.parent is not None:
            found.append(node.action)
            node = node.parent
        return found[::-1]


@dataclass(slots=True)
class Node:
    """A state: a copy of the environment, or the path to replay if the environment cannot be copied."""

    env: Any
    path: Path
    total: float
    visits: int = 0
    ended: bool = False
    cell: Any = None


@dataclass(slots=True)
class Outcome:
    """The results of a search so far."""

    steps: int = 0
    copies: bool = True
    crash: list[Any] | None = None
    win: list[Any] | None = None
    win_return: float = 0.0
    best: list[Any] = field(default_factory=list)
    best_return: float = float("-inf")
    loop: list[Any] | None = None
    loop_length: int = 0
    still: list[Any] | None = None
    still_length: int = 0
    paid: int = 0
    states: int = 0
    late_states: int = 0
    exhausted: bool = False
    stochastic: bool = False
    player: str = ""
    place: str = ""
    board: str = ""
    placed: int = 0
    looked: int = 0
    enclosed: list[int] = field(default_factory=list)

    def json(self) -> dict[str, Any]:
        lists = ("crash", "win", "best", "loop", "still")
        values = {name: getattr(self, name) for name in self.__slots__}
        return {name: value if name in lists else jsonable(value) for name, value in values.items()}


class Tree:
    """Branches of one seeded episode."""

    def __init__(self, subject: Subject, job: Job) -> None:
        self.subject = subject
        self.seed: int = job["seed"]
        self.actions: list[Any] = job["actions"]
        self.path: list[Any] = job.get("path", [])
        self.budget: int = job["max_steps"]
        self.out = Outcome()
        self.random = _Random(job["seed"])
        self.limit: int = job["limit"]
        self.counter: tuple[str, int] = job.get("counter", ("", 0))
        self.until = _monotonic() + job.get("seconds", float("inf"))
        #: Whether info reports success, or the lack of it.
        self.reports = False
        #: A search that proves something relies on no habits of games.
        self.exact: bool = job["search"] == "exhaust"
        self.copies: Copies
        #: If the environment cannot be copied, the instance of the last branch.
        self._replayed: Any = None

    def root(self) -> Node:
        env = self.subject.construct(announce=False)
        observation, _ = self.subject.call("reset", env.reset, seed=self.seed)
        self.frame = observation
        node = Node(env, Path(None, None, 0), 0.0)
        try:
            self.copies = Copies(env, exact=self.exact)
            self.copies.of(env)
        except BaseException:
            # Copying runs the environment's own code, which can raise anything.
            self.out.copies = False
        return node

    def branch(self, node: Node) -> Node:
        """A copy of `node` that can be stepped without changing `node`."""
        if self.out.copies:
            return Node(self.copies.of(node.env), node.path, node.total)
        env = self._reset_instance()
        for action in node.path.actions():
            self.subject.step("step", env, action)
            self.out.steps += 1
        self._replayed = env
        return Node(env, node.path, node.total)

    def _reset_instance(self) -> Any:
        """The instance of the last branch, which no search steps any more, after a reset; a new one if it cannot be
        used again.
        """
        env, self._replayed = self._replayed, None
        if env is not None:
            try:
                self.subject.call("reset", env.reset, seed=self.seed)
                return env
            except Fault:
                pass
        env = self.subject.construct(announce=False)
        self.subject.call("reset", env.reset, seed=self.seed)
        return env

    def step(self, node: Node, action: Any) -> bool:
        """Step `node` in place; False once its episode is over or fails."""
        self.out.steps += 1
        path = node.path.then(action)
        try:
            result = self.subject.step("step", node.env, action)
            observation, reward, terminated, truncated, info = result
            reward = float(reward)
        except (Fault, TypeError, ValueError):
            self._replayed = None
            if self.out.crash is None or path.length < len(self.out.crash):
                self.out.crash = path.actions()
            return False
        self.subject.channel.tick()
        self.frame = observation
        node.path = path
        node.total += reward
        self.out.paid += reward != 0
        node.ended = bool(terminated) or bool(truncated) or path.length >= self.limit
        self._judge(node, info)
        return not node.ended

    def spent(self) -> bool:
        return self.out.steps >= self.budget or _monotonic() > self.until

    def _judge(self, node: Node, info: Any) -> None:
        contract = self.subject.contract
        success = info.get(contract.get("success", "is_success")) if isinstance(info, dict) else None
        if isinstance(success, str | list | tuple | dict):
            # Not an answer: "no" would be true.
            success = None
        self.reports |= success is not None
        won = bool(success) if success is not None else contract.get("sign", True) and node.ended and node.total > 0
        if won and (self.out.win is None or node.path.length < len(self.out.win)):
            self.out.win, self.out.win_return = node.path.actions(), node.total
        if node.total > self.out.best_return:
            self.out.best, self.out.best_return = node.path.actions(), node.total


def frame_hash(frame: Any) -> int:
    """Tells observations apart within a search; 64 bits, of some ten thousand."""
    if not isinstance(frame, np.ndarray):
        return hash(encode_value(frame)[1])
    if frame.dtype.kind not in "biuf":
        return hash(np.ndarray.tobytes(frame))
    frame = np.asarray(frame)
    # Rows or columns of pixels, as they lie in memory.
    if not frame.flags.c_contiguous and frame.ndim == 3 and frame.transpose(1, 0, 2).flags.c_contiguous:
        number: int = _hash(frame.transpose(1, 0, 2), 1)
    else:
        number = _hash(np.ascontiguousarray(frame))
    return number


def global_generators() -> str:
    """The state of the generators that all code shares."""
    state: Any = np.random.get_state()
    _, key, *rest = state
    return repr((random.getstate(), key.tobytes(), rest))
