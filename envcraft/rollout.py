"""A request for one episode: seed, actions, and the conditions under which the process runs it.

A rollout runs in a process of its own, or after others in one that they left as it was, so its trace depends on nothing
but the source and the request: it can be memoised, run in parallel, and run again from a report.
"""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import Any

import msgspec

Action = Any


class Episode(msgspec.Struct, frozen=True, omit_defaults=True):
    """An episode that is played but not recorded; with None for its seed it goes on from the one before."""

    seed: int | None
    actions: list[Action]


class ClockShift(msgspec.Struct, frozen=True):
    """`offset` in seconds; `rate` is the clock's speed, and 0 the logical clock (one millisecond a reading)."""

    offset: float
    rate: float


class Conditions(msgspec.Struct, frozen=True, omit_defaults=True):
    """What differs from an ordinary process. The defaults differ in nothing.

    Attributes:
        fresh: a worker of its own (a fresh container or namespace), not a fork of the usual one.
        heap: allocate and free objects first, drawn from this seed, so that new ones have other addresses.
        hash_seed: PYTHONHASHSEED of the worker.
        global_seed: seeds the global ``random`` and ``numpy.random`` before the file is loaded; None: the episode's.
        perturb: reseed both global generators from this before each call.
        clock: another clock.
        again: play the episode twice in one process, each time on a new instance, and record both.
        before: episodes played before, on the same instance.
        companion: a second instance, stepped in turn with the first through these actions.
        render: call ``render()`` after each reset and step, and send the frame.
        reread: some steps after an observation, and at the episode's end, send it again as it is then; after each step
            the action.
        after_end: steps to take past the episode's end.
        options: pass ``options={}`` to reset, and reset once more after the episode, as wrappers do.
        closed: make another instance before, and close it at once.
        unseeded: reset without a seed, as loops do for every episode but the first.
    """

    fresh: bool = False
    heap: int | None = None
    hash_seed: int = 0
    global_seed: int | None = None
    perturb: int | None = None
    clock: ClockShift | None = None
    again: bool = False
    before: list[Episode] = []
    companion: Episode | None = None
    render: bool = False
    reread: bool = False
    after_end: int = 0
    options: bool = False
    closed: bool = False
    unseeded: bool = False

    @property
    def passing(self) -> bool:
        """Whether the process is afterwards as it is after an episode without conditions."""
        return not self.again and (self.heap, self.global_seed, self.perturb, self.clock) == (None,) * 4

    def to_json(self) -> dict[str, Any]:
        """Give the conditions that differ from the defaults."""
        result: dict[str, Any] = msgspec.to_builtins(self)
        return result

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Conditions:
        """Read what :meth:`to_json` wrote. Raises msgspec.ValidationError."""
        return msgspec.convert(value, cls)


class Rollout(msgspec.Struct, frozen=True, dict=True):
    """One episode to run.

    `player` names the action source in messages; in place of `actions` come for `max_steps` those of the privileged
    policy with `policy`, or those that the host is asked for one by one with `asked`; `keep` holds on to the frames of
    the first so many observations.
    """

    seed: int
    actions: list[Action]
    conditions: Conditions = Conditions()
    player: str = "these actions"
    policy: bool = False
    asked: bool = False
    max_steps: int = 0
    keep: int = 0

    @property
    def live(self) -> bool:
        """Whether the actions are chosen while the episode is played."""
        return self.policy or self.asked

    def key(self) -> bytes:
        """What the trace depends on; the player's name is not part of it."""
        return self._key

    @cached_property
    def _key(self) -> bytes:
        parts = (self.seed, self.actions, self.conditions, self.policy, self.max_steps, self.keep)
        return hashlib.blake2b(msgspec.json.encode(parts), digest_size=16).digest()

    def cut(self, steps: int) -> Rollout:
        """The same episode, no longer than `steps`."""
        return msgspec.structs.replace(self, actions=self.actions[:steps])

    def under(self, conditions: Conditions) -> Rollout:
        return msgspec.structs.replace(self, conditions=conditions)
