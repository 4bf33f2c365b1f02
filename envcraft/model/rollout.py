"""Requests for one episode (seed, actions, and the conditions under which the process runs it) and for one search.

A rollout runs in a process of its own, or in one that earlier rollouts left unchanged. Its trace depends only on the
source and the request, so it can be memoised, run in parallel, and run again from a report.
"""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from envcraft_protocol import jobs

Action = Any


class Episode(msgspec.Struct, frozen=True, omit_defaults=True):
    """An episode before or beside the one of a rollout. A seed of None resets without a seed.

    With `lines` the lines of Python that it runs are counted, if it is recorded.
    """

    seed: int | None
    actions: list[Action]
    lines: bool = False


class ClockShift(msgspec.Struct, frozen=True):
    """`offset` in seconds. `rate` is the speed of the clock; 0 is a logical clock of one millisecond a reading."""

    offset: float
    rate: float


class Conditions(msgspec.Struct, frozen=True, omit_defaults=True):
    """Changes to an ordinary process. The defaults change nothing.

    Attributes:
        fresh: a worker of its own (a fresh container or namespace), not a fork of the usual one.
        heap: seed for objects that are allocated and freed first, so that new objects have other addresses.
        hash_seed: PYTHONHASHSEED of the worker.
        global_seed: seeds the global ``random`` and ``numpy.random`` before the import, and ``torch`` where the file
            imports it; None uses the episode's seed.
        perturb: reseeds these global generators before each call.
        clock: replaces the clock.
        again: plays the episode twice in one process, each time on a new instance, and records both.
        before: episodes that are played first, on the same instance.
        companion: the episode of a second instance, which is stepped in turn with the first.
        render: calls ``render()`` after each reset and step, and sends the frame; and after each episode of `before`.
        reread: watches all observations until the end of the episode, not only those that the environment refers to,
            and actions of every type.
        after_end: steps to take after the episode's end.
        options: passes ``options={}`` to reset, and resets once more after the episode, as wrappers do.
        closed: constructs another instance first, and closes it at once.
        unseeded: resets without a seed, as training does for every episode but the first.
        reuse: overwrites the action array of the step before for each step, instead of making a new one.
        int32: passes integers of actions as int32 if the action space contains that.
        python: passes integers of actions as Python's ints and lists if the action space contains that. With `int32`
            both take turns.
        unrendered: constructs the instance without a render mode, as ``gymnasium.make(id)`` does.
        recorded: records the episodes of `before`, too, and measures the process after each. After some seconds no
            further one starts.
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
    reuse: bool = False
    int32: bool = False
    python: bool = False
    unrendered: bool = False
    recorded: bool = False

    @property
    def passing(self) -> bool:
        """Whether the conditions leave the process as an ordinary episode does."""
        return (
            not (self.again or self.recorded) and (self.heap, self.global_seed, self.perturb, self.clock) == (None,) * 4
        )

    def to_json(self) -> jobs.Conditions:
        """The conditions that differ from the defaults."""
        result: jobs.Conditions = msgspec.to_builtins(self)
        return result

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Conditions:
        """Read what :meth:`to_json` wrote. Raises msgspec.ValidationError."""
        return msgspec.convert(value, cls)


class Rollout(msgspec.Struct, frozen=True, dict=True):
    """One episode to run.

    `player` names the action source in messages. With `policy` the privileged policy chooses up to `max_steps`
    actions, and with `interactive` a player on the host does; `actions` is empty then. With `policy` and `actions` the
    actions are taken, and the policy says in each state what it would do. `keep` is the number of
    observations, from the first, whose frames the trace keeps. With `fields` it also keeps the fields of each state.
    """

    seed: int
    actions: list[Action]
    conditions: Conditions = Conditions()
    player: str = "these actions"
    policy: bool = False
    interactive: bool = False
    max_steps: int = 0
    keep: int = 0
    fields: bool = False

    @property
    def live(self) -> bool:
        """Whether actions are chosen during the episode."""
        return self.policy or self.interactive

    def key(self) -> bytes:
        """A digest of everything that the trace depends on; the player's name is not part of it."""
        return self._key

    @cached_property
    def _key(self) -> bytes:
        parts = (self.seed, self.actions, self.conditions, self.policy, self.max_steps, self.keep, self.fields)
        return hashlib.blake2b(msgspec.json.encode(parts), digest_size=16).digest()

    def cut(self, steps: int) -> Rollout:
        """The same episode with at most `steps` actions."""
        return msgspec.structs.replace(self, actions=self.actions[:steps])

    def under(self, conditions: Conditions) -> Rollout:
        return msgspec.structs.replace(self, conditions=conditions)


class Search(msgspec.Struct, frozen=True):
    """A request for one search in the worker.

    Attributes:
        kind: which search, see the worker.
        seed: the seed of the episode.
        budget: the most environment steps.
        path: the actions that the search follows, if any.
        counter: the attribute that counts steps, and the number at which the episode ends, if the search needs them.
    """

    kind: str
    seed: int
    budget: int
    path: list[Action] = []
    counter: tuple[str, int] | None = None

    def key(self) -> bytes:
        """What the outcome depends on."""
        return msgspec.json.encode((self.kind, self.seed, self.budget, self.path, self.counter))
