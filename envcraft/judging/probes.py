"""The episodes that checks request, as rollouts that have not run yet."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from typing import Any

from envcraft.errors import Skip
from envcraft.judging import actions
from envcraft.judging.budget import Budget
from envcraft.model.contract import Contract
from envcraft.model.rollout import Action, Episode, Rollout
from envcraft.model.trace import Trace
from envcraft.spaces.sampling import enumerate_actions
from envcraft.spaces.spec import Discrete, MultiDiscrete, SpaceSpec
from envcraft.text import plural

_Draw = Callable[[SpaceSpec, int, int], list[Action]]
#: Other earlier episodes last at most so many times as long as the random ones.
_MODERATE = 4


class Probes:
    """The rollouts of one subject. `seed` is that of the validation; `space` holds the actions."""

    def __init__(self, contract: Contract, budget: Budget, seed: int, space: SpaceSpec) -> None:
        self.contract = contract
        self.budget = budget
        self.seed = seed
        self.space = space
        self._known: dict[tuple[Any, ...], Rollout] = {}

    @property
    def length(self) -> int:
        """The number of actions of an episode."""
        return self.contract.limit or self.budget.length

    @cached_property
    def joint_actions(self) -> list[Action]:
        """The joint actions, or a sample where they cannot be counted; the first one does nothing."""
        return enumerate_actions(self.space)

    def episode_seed(self, number: int) -> int:
        """The seed of the episode with this number; each ``--seed`` has its own."""
        return self.seed * 100_003 + number

    def random(self, number: int, length: int | None = None) -> Rollout:
        """Random play on the episode seed `number`."""
        return self._drawn(actions.random_actions, number, length or self.length, "random play")

    def sticky(self, number: int) -> Rollout:
        """Random play in which each action is held for a while."""
        return self._drawn(actions.sticky_actions, number, self.length, "random play with held actions")

    def hold(self, action: Action, number: int = 0, length: int | None = None) -> Rollout:
        """One action throughout."""
        player = "doing nothing" if action == self.contract.noop else f"holding {action}"
        return Rollout(self.episode_seed(number), actions.held_action(action, length or self.length), player=player)

    def noop(self, number: int = 0, length: int | None = None) -> Rollout:
        """An episode of doing nothing. Raises Skip under a contract that names no such action."""
        if self.contract.noop is None:
            raise Skip(f"the contract {self.contract.name} names no action that does nothing")
        return self.hold(self.contract.noop, number, length)

    def rotation(self, offset: int) -> Rollout:
        """Every joint action in a shuffled order that starts at `offset`."""
        number, offset = divmod(offset, len(self.joint_actions))
        seed = self.episode_seed(number)
        order = actions.rotation(self.joint_actions, offset, seed, self.length)
        return Rollout(seed, order, player="every action in turn")

    def onward(self, path: Rollout) -> Iterator[Rollout]:
        """Yield whole episodes that begin with the actions of `path`: then nothing, random play or held actions."""
        left = max(self.length - len(path.actions), 0)
        if self.contract.noop is not None:
            yield _then(path, actions.held_action(self.contract.noop, left), "doing nothing")
        for number in itertools.count(1):
            seed = self.episode_seed(number)
            yield _then(path, actions.random_actions(self.space, seed, left), "random play")
            yield _then(path, actions.sticky_actions(self.space, seed, left), "random play with held actions")

    def policy(self, number: int) -> Rollout:
        """The privileged policy on the episode seed `number`."""
        return Rollout(self.episode_seed(number), [], player="the policy", policy=True, max_steps=self.length)

    def earlier(self, rollout: Rollout, found: Trace | None, idle: Trace | None) -> list[Episode]:
        """Episodes to play before one on the same instance.

        Args:
            rollout: the episode.
            found: the best episode of a search. If it is won, it is played at least twice.
            idle: an episode of doing nothing.

        Returns:
            Two random episodes; before one with the first episode seed also `found` and `idle`, unless they are long;
            and last the very same episode.
        """
        seed, length = rollout.seed + 7_919, self.budget.earlier
        draws: tuple[_Draw, ...] = (actions.random_actions, actions.sticky_actions)
        episodes = [Episode(seed + at, draw(self.space, seed + at, length)) for at, draw in enumerate(draws)]
        if rollout.seed == self.episode_seed(0):
            if found is not None and found.steps <= _MODERATE * length:
                wins = max(min(_MODERATE * length // max(found.steps, 1), self.budget.wins), 2)
                episodes += [Episode(found.rollout.seed, found.actions)] * (wins if found.positive else 1)
            if idle is not None and idle.ended and idle.steps <= _MODERATE * length:
                episodes.append(Episode(seed, idle.actions))
            # What every second reset undoes shows after an odd number of episodes.
            episodes += [Episode(seed, [])] * (len(episodes) % 2)
        return [*episodes, Episode(rollout.seed, rollout.actions)]

    def _drawn(self, draw: _Draw, number: int, length: int, player: str) -> Rollout:
        """Return an episode of drawn actions. Each call returns the same object, so that its key is computed once."""
        wanted = (draw, number, length)
        if wanted not in self._known:
            seed = self.episode_seed(number)
            # Actions of other spaces may be large, so they are not cached.
            few = isinstance(self.space, Discrete | MultiDiscrete)
            drawn = _draw(draw, self.space, seed, length) if few else draw(self.space, seed, length)
            self._known[wanted] = Rollout(seed, drawn, player=player)
        return self._known[wanted]


def _then(path: Rollout, later: list[Action], player: str) -> Rollout:
    return Rollout(path.seed, path.actions + later, player=f"{player} after {plural(len(path.actions), 'step')}")


@lru_cache(maxsize=256)
def _draw(draw: _Draw, space: SpaceSpec, seed: int, length: int) -> list[Action]:
    """Cache the actions, because environments of one contract play the same episodes. Do not change the list."""
    return draw(space, seed, length)
