"""The episodes that several checks share, played as far as the budget allows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

from envcraft.judging.budget import Budget
from envcraft.judging.probes import Probes
from envcraft.judging.rollout_cache import RolloutCache
from envcraft.model.rollout import Action, Conditions, Rollout
from envcraft.model.trace import Trace
from envcraft.similarity.behavioural import STEPS

#: The share of the budget that is left to further whole episodes where these may show a defect.
_RESERVE = 0.15
#: The most of it for further episodes of random play, or of a held action, where the first one wins.
_WINS = 0.5
#: Steps of the shortest cut, and the steps past the end of an episode.
_SHORTEST, _PAST_END = 30, 5
#: The shares of the remaining steps that varied play and held actions take where episodes are long. What follows takes
#: the rest, since only there every joint action is tried at every step.
_VARIED, _HELD = 0.12, 0.15
#: Where all episodes can be whole in this share of the steps, they are.
_EQUAL = 0.55
#: Longer episodes bind a validation to the budget; with shorter ones it may exceed it by a part.
_LONG, _PART = 500, 2
#: How many times as much as other play a held action earns that may win in the end.
_CLEARLY = 2
#: The most steps of further held actions.
_HOLD = 120
#: How many times longer an action of one component is held than one of several.
_SIMPLE = 4


class Episodes:
    """The shared episodes of one subject.

    The first two are whole, since some defects show only at the end of an episode. Each later one is cut at its share
    of the steps that are left.
    """

    def __init__(self, cache: RolloutCache, probes: Probes, budget: Budget) -> None:
        self._cache = cache
        self._probes = probes
        self._budget = budget
        #: The steps of a held action that were played again as a part of its whole episode.
        self._repeated = 0

    @cached_property
    def whole(self) -> list[Trace]:
        """Random play, and doing nothing where the contract names an action for it."""
        rollouts = [self._probes.random(0)]
        if self._probes.contract.noop is not None:
            idle = self._probes.noop()
            rollouts.append(idle)
            # One episode also shows what happens past its end.
            self._cache.prefetch([rollouts[0]], alone=True)
            self._cache.rollout(self.past_end(idle))
        return self._play(rollouts)

    @property
    def steps_left(self) -> int:
        """The steps that the budget has left, negative if more were taken.

        The budget is meant for episodes of 1,000 steps. Short episodes have half as much again.
        """
        return self._cache.steps_left + (0 if self.long else self._budget.steps // _PART)

    @property
    def long(self) -> bool:
        """Whether episodes are so long that the budget binds."""
        return max(trace.steps for trace in self.whole) > _LONG

    @property
    def looks(self) -> tuple[int, ...]:
        """The numbers of episodes after which a statistical verdict is looked at."""
        return self._budget.looks_for(max(trace.steps for trace in self.whole))

    @property
    def idle(self) -> Trace | None:
        """The episode of doing nothing; None under a contract that names no such action."""
        return self.whole[1] if len(self.whole) > 1 else None

    def more_whole(self) -> Iterator[Trace]:
        """Yield further whole episodes of varied play, as long as the budget allows them."""
        for rollout in self._varied:
            if self.steps_left < max(trace.steps for trace in self.whole):
                return
            yield self._cache.rollout(rollout)

    def more_held(self, least: int = 0) -> list[Trace]:
        """The other joint actions, each held on the first seed, as long as the budget allows, or for `least` steps."""
        held = [trace.rollout.actions[0] for trace in self.held]
        others = [action for action in self._probes.joint_actions if action not in held]
        length = max(min(max(self.steps_left // max(len(others), 1), least), _HOLD), _SHORTEST)
        return self._play([self._probes.hold(action).cut(length) for action in others])

    def past_end(self, rollout: Rollout) -> Rollout:
        """The same episode with some steps past its end."""
        return rollout.under(Conditions(after_end=_PAST_END))

    @cached_property
    def varied(self) -> list[Trace]:
        """Further random play, and random actions that are held for a while."""
        length = self._share(len(self._varied), self._budget.held + self._budget.rotations, _VARIED, self.whole)
        # The fingerprint describes so many steps of the first sticky episode.
        fewest = {id(self._probes.sticky(0)): STEPS}
        return self._play([each.cut(max(length, fewest.get(id(each), 0))) for each in self._varied])

    @cached_property
    def _varied(self) -> list[Rollout]:
        rollouts = [self._probes.random(number) for number in range(1, self._budget.random)]
        rollouts += [self._probes.sticky(number) for number in range(self._budget.sticky)]
        if self._probes.contract.noop is not None and self._budget.rotations:
            rollouts.append(self._probes.noop(1))
        return rollouts

    @cached_property
    def held(self) -> list[Trace]:
        """Joint actions, as many as the budget allows, each held on the first seed. The first does nothing."""
        joint = self._probes.joint_actions
        # Simple actions come first where not all can be held.
        ordered = sorted(joint[1:], key=lambda action: not self._is_simple(action))[: self._budget.held - 1]
        rollouts = [self._probes.hold(action) for action in joint if action is joint[0] or action in ordered]
        known = [trace for trace in self.whole if trace.rollout.key() == rollouts[0].key()]
        left, played = rollouts[len(known) :], [*self.whole, *self.varied]
        share = _HELD if self._budget.rotations else 1.0
        length = self._share(len(left), self._budget.rotations, share, played)
        simple = [self._is_simple(rollout.actions[0]) for rollout in left]
        # The weights keep the sum.
        unit = length * len(left) / max(sum(_SIMPLE if one else 1 for one in simple), 1)
        lengths = [max(int(unit * _SIMPLE if one else unit), _SHORTEST) for one in simple]
        held = self._play([rollout.cut(steps) for rollout, steps in zip(left, lengths, strict=True)])
        best = max(range(len(held)), key=lambda index: held[index].total, default=None)
        if best is not None and self._may_win(held[best]):
            self._repeated = held[best].steps
            held[best] = self._play([left[best]])[0]
        return known + held

    def _may_win(self, trace: Trace) -> bool:
        """Whether an episode of a held action that was cut earns so much more than other play that it may win."""
        others = [sum(whole.rewards[: trace.steps]) for whole in self.whole]
        cut = trace.usable and not trace.ended and self._cache.steps_left > self._budget.steps // _PART
        return cut and trace.total > _CLEARLY * max(0.0, *others)

    @cached_property
    def rotations(self) -> list[Trace]:
        """Episodes that together try every joint action at every step."""
        rollouts = [self._probes.rotation(offset) for offset in range(self._budget.rotations)]
        length = self._share(len(rollouts), 0, 1.0, self.all)
        length = max(length - (self.reserve + self._repeated) // max(len(rollouts), 1), _SHORTEST)
        return self._play([rollout.cut(length) for rollout in rollouts])

    @property
    def reserve(self) -> int:
        """The steps that other play leaves, because the whole episodes look like a defect that more of them show."""
        first = self.whole[0]
        alike = first.total > 0 and all(trace.total == first.total for trace in self.whole[1:])
        still = len(set(first.observations[first.steps // 2 :])) == 1
        limit = self._probes.contract.limit
        same = len(self.whole) > 1 and len({trace.steps for trace in self.whole}) == 1
        lost = any(
            (same or trace.steps == limit) and trace.ended and trace.terminated[-1] and not trace.success
            for trace in self.whole
        )
        failed = any(trace.fault is not None for trace in self.whole)
        reserved = int(_RESERVE * self._budget.steps) if alike or still or lost or failed else 0
        won = [trace.steps for trace in self.held if trace.success]
        won += [first.steps] if first.success else []
        # Only the episodes of all looks settle whether random play, or a held action, wins nearly always.
        needed = self.looks[-1] * min(won, default=0)
        return max(reserved, min(needed, int(_WINS * self._budget.steps)))

    @cached_property
    def all(self) -> list[Trace]:
        """Random play, held actions and doing nothing."""
        return list({trace.rollout.key(): trace for trace in [*self.whole, *self.varied, *self.held]}.values())

    @cached_property
    def probed(self) -> list[Trace]:
        """The episodes on whose seeds determinism is probed."""
        return [trace for trace in [self.whole[0], *self.varied] if self._is_probed(trace.rollout)]

    def _is_probed(self, rollout: Rollout) -> bool:
        numbers = range(self._budget.probes[0])
        probed = [(self._probes.sticky if number % 2 else self._probes.random)(number) for number in numbers]
        return any(rollout.seed == each.seed and rollout.player == each.player for each in probed)

    def _is_simple(self, action: Action) -> bool:
        """Whether a joint action differs from doing nothing in one component."""
        noop = self._probes.contract.noop
        if not isinstance(action, list) or not isinstance(noop, list):
            return True
        return sum(bool(one != none) for one, none in zip(action, noop, strict=True)) <= 1

    def _share(self, episodes: int, later: int, share: float, played: Sequence[Trace]) -> int:
        """The steps at which each of several episodes is cut.

        Args:
            episodes: their number.
            later: the number of episodes that follow them.
            share: the share of the steps that are left for them if the episodes are long.
            played: the episodes before.
        """
        left = max(self._budget.play - sum(trace.steps for trace in played), 0)
        equal = int(left * _EQUAL) // max(episodes + later, 1)
        typical = max(trace.steps for trace in self.whole)
        length = equal if typical <= equal else int(left * share) // max(episodes, 1)
        return max(length, _SHORTEST)

    def _play(self, rollouts: Sequence[Rollout]) -> list[Trace]:
        """Play side by side. Nothing runs before a probed episode in its process."""
        alone = [self._is_probed(rollout) for rollout in rollouts]
        for rollout, by_itself in zip(rollouts, alone, strict=True):
            self._cache.prefetch([rollout], alone=by_itself)
        return [self._cache.rollout(rollout, by_itself) for rollout, by_itself in zip(rollouts, alone, strict=True)]
