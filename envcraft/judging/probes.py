"""The episodes that checks request, as rollouts that have not run yet."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

from envcraft.errors import Skip
from envcraft.judging import actions
from envcraft.judging.budget import Budget
from envcraft.model.contract import Contract
from envcraft.model.rollout import Action, Episode, Rollout
from envcraft.spaces.sampling import enumerate_actions
from envcraft.spaces.spec import Discrete, MultiDiscrete, SpaceSpec

_Draw = Callable[[SpaceSpec, int, int], list[Action]]
#: The length of a random earlier episode, and the number of earlier resets without a step.
_EARLIER_STEPS, _EARLIER_RESETS = 200, 8


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
        return self.contract.limit or self.budget.steps

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

    @cached_property
    def determinism(self) -> list[Rollout]:
        """The episodes on whose seeds determinism is probed."""
        return [(self.sticky if number % 2 else self.random)(number) for number in range(self.budget.probes[0])]

    @cached_property
    def rotations(self) -> list[Rollout]:
        return [self.rotation(offset) for offset in range(self.budget.rotations)]

    @cached_property
    def held(self) -> list[Rollout]:
        """Each joint action (as many as the budget allows) held on the first seed."""
        stride = max(len(self.joint_actions) // self.budget.held, 1)
        return [self.hold(action) for action in self.joint_actions[::stride]]

    def policy(self, number: int) -> Rollout:
        """The privileged policy on the episode seed `number`."""
        return Rollout(self.episode_seed(number), [], player="the policy", policy=True, max_steps=self.length)

    @cached_property
    def all(self) -> list[Rollout]:
        """The episodes that several checks share: random, sticky, held and doing nothing."""
        rollouts = [self.random(number) for number in range(self.budget.random)]
        rollouts += [self.sticky(number) for number in range(self.budget.sticky)]
        rollouts += self.held
        if self.contract.noop is not None:
            rollouts += [self.noop(number) for number in range(1, 3)]
        return rollouts

    def earlier(self, rollout: Rollout, found: Rollout | None) -> list[Episode]:
        """Return episodes to play before a rollout on the same instance.

        They are two random episodes and, last, the rollout's own episode. On the first episode seed, they also include
        the search's episode twice, an episode of doing nothing to the end, and many resets.

        Args:
            rollout: the request.
            found: the best episode of a search, if there is one.
        """
        seed = rollout.seed + 7_919
        draws: tuple[_Draw, ...] = (actions.random_actions, actions.sticky_actions)
        episodes = [Episode(seed + at, draw(self.space, seed + at, _EARLIER_STEPS)) for at, draw in enumerate(draws)]
        if rollout.seed == self.episode_seed(0):
            if found is not None:
                episodes += [Episode(found.seed, found.actions)] * 2
            if self.contract.noop is not None:
                episodes.append(Episode(seed, actions.held_action(self.contract.noop, self.length)))
            episodes += [Episode(seed + number, []) for number in range(_EARLIER_RESETS)]
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


@lru_cache(maxsize=256)
def _draw(draw: _Draw, space: SpaceSpec, seed: int, length: int) -> list[Action]:
    """Cache the actions, because environments of one contract play the same episodes. Do not change the list."""
    return draw(space, seed, length)
