"""Many short episodes on one instance: for what shows only after many resets, or on few seeds."""

from __future__ import annotations

from functools import cached_property

from envcraft.judging.budget import Budget
from envcraft.judging.episodes import Episodes
from envcraft.judging.probes import Probes
from envcraft.judging.rollout_cache import RolloutCache
from envcraft.model.rollout import Conditions, Episode, Rollout
from envcraft.model.trace import Trace

#: Episodes of doing nothing, on the seeds 1, 2, ….
_IDLE = 5
#: Whole episodes of a short game, and the most steps of all of them.
_WHOLE, _WHOLE_STEPS = 12, 240
#: Repetitions that come before those that are measured: the first ones load what all later ones use.
_FIRST = 2


class Session:
    """The session of one subject.

    It repeats one episode, first without and then with its steps, does nothing on a few seeds, plays at random on many,
    repeats a whole episode if that is short, and ends with the first steps of the repeated episode, which is the shared
    random one. All but the last are in :attr:`envcraft.model.trace.Trace.before`. A slow environment plays fewer.
    """

    def __init__(self, cache: RolloutCache, probes: Probes, episodes: Episodes, budget: Budget) -> None:
        self._cache = cache
        self._probes = probes
        self._shared = episodes
        self._seeds, self.steps, self._repeated, self._last = budget.session

    @cached_property
    def rollout(self) -> Rollout:
        """The request."""
        first = self._probes.random(0)
        return first.cut(self._last).under(Conditions(before=self._episodes, recorded=True))

    @property
    def trace(self) -> Trace:
        """The last episode, and all before it."""
        return self._cache.rollout(self.rollout)

    @property
    def resets(self) -> list[Trace]:
        """The repetitions without steps."""
        return self.trace.before[_FIRST : _FIRST + self._repeated]

    @property
    def repeated(self) -> list[Trace]:
        """The repetitions with steps."""
        start = _FIRST + self._repeated
        return self.trace.before[start : start + self._repeated]

    @property
    def repetitions(self) -> range:
        """The positions of all repetitions in the session."""
        return range(min(_FIRST + 2 * self._repeated, len(self.trace.before)))

    @property
    def complete(self) -> bool:
        """Whether time allowed all repetitions."""
        return len(self.repeated) == self._repeated

    def idle(self, number: int) -> Trace | None:
        """The episode of doing nothing on the episode seed `number`, if there is one."""
        start = _FIRST + 2 * self._repeated
        known = self.trace.before[start : start + self._idle]
        return known[number - 1] if 0 < number <= len(known) else None

    @property
    def varied(self) -> list[Trace]:
        """Random play on many seeds."""
        start = _FIRST + 2 * self._repeated + self._idle
        return self.trace.before[start : start + self._seeds]

    @property
    def whole(self) -> list[Trace]:
        """The repetitions of a whole episode, if there are any."""
        return self.trace.before[_FIRST + 2 * self._repeated + self._idle + self._seeds :]

    @cached_property
    def short(self) -> Rollout | None:
        """The shorter one of the shared whole episodes; None if repeating it takes too many steps."""
        ended = [trace for trace in self._shared.whole if trace.ended]
        shortest = min(ended, key=lambda trace: trace.steps, default=None)
        if shortest is None or _WHOLE * shortest.steps > _WHOLE_STEPS:
            return None
        return shortest.rollout.cut(shortest.steps)

    @cached_property
    def _idle(self) -> int:
        return 0 if self._probes.contract.noop is None else _IDLE

    @cached_property
    def _episodes(self) -> list[Episode]:
        first = self._probes.random(0)
        same = first.actions[: self.steps]
        counted = Episode(first.seed, same, lines=True)
        repeated = [*[Episode(first.seed, [])] * self._repeated, *[Episode(first.seed, same)] * (self._repeated - 1)]
        idle = [self._probes.noop(number, self._probes.contract.at_once) for number in range(1, self._idle + 1)]
        varied = [self._probes.random(number, self.steps) for number in range(1, self._seeds + 1)]
        others = [Episode(rollout.seed, rollout.actions) for rollout in [*idle, *varied]]
        whole = [Episode(self.short.seed, self.short.actions)] * _WHOLE if self.short is not None else []
        return [Episode(first.seed, same), counted, *repeated, counted, *others, *whole]
