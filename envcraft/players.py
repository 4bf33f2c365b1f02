"""Who plays: the episodes that checks ask for, as rollouts that nobody has run yet."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

from envcraft import actions, spaces
from envcraft.budget import Budget
from envcraft.check import Skip
from envcraft.contract import Contract
from envcraft.rollout import Action, Episode, Rollout

_Draw = Callable[[spaces.Space, int, int], list[Action]]
#: Steps of an earlier episode at random, and how many resets without a step come before.
_EARLIER_STEPS, _EARLIER_RESETS = 200, 8


class Players:
    """The rollouts of one subject. `seed` is that of the validation; `space` holds the actions."""

    def __init__(self, contract: Contract, budget: Budget, seed: int, space: spaces.Space) -> None:
        self.contract = contract
        self.budget = budget
        self.seed = seed
        self.space = space
        self._known: dict[tuple[Any, ...], Rollout] = {}

    @property
    def length(self) -> int:
        """How many actions an episode is given."""
        return self.contract.limit or self.budget.steps

    @cached_property
    def choices(self) -> list[Action]:
        """The joint actions, or a sample of them where they cannot be counted; first the one that does nothing."""
        return spaces.enumerate_actions(self.space)

    def episode_seed(self, number: int) -> int:
        """The seed of the episode with this number, away from the seeds of another ``--seed``."""
        return self.seed * 100_003 + number

    def random(self, number: int, length: int | None = None) -> Rollout:
        """Random play on the episode seed `number`."""
        return self._drawn(actions.random_actions, number, length or self.length, "random play")

    def sticky(self, number: int) -> Rollout:
        """Random play with held actions."""
        return self._drawn(actions.sticky_actions, number, self.length, "random play with held actions")

    def hold(self, action: Action, number: int = 0, length: int | None = None) -> Rollout:
        """One action throughout."""
        player = "doing nothing" if action == self.contract.noop else f"holding {action}"
        return Rollout(self.episode_seed(number), actions.held_action(action, length or self.length), player=player)

    def noop(self, number: int = 0, length: int | None = None) -> Rollout:
        """Doing nothing. Raises Skip under a contract that knows no such action."""
        if self.contract.noop is None:
            raise Skip(f"the contract {self.contract.name} names no action that does nothing")
        return self.hold(self.contract.noop, number, length)

    def rotation(self, offset: int) -> Rollout:
        """Every joint action in a shuffled order, begun at `offset`."""
        number, offset = divmod(offset, len(self.choices))
        seed = self.episode_seed(number)
        order = actions.rotation(self.choices, offset, seed, self.length)
        return Rollout(seed, order, player="every action in turn")

    @cached_property
    def probes(self) -> list[Rollout]:
        """The episodes on whose seeds determinism is probed."""
        return [(self.sticky if number % 2 else self.random)(number) for number in range(self.budget.probes[0])]

    @cached_property
    def rotations(self) -> list[Rollout]:
        return [self.rotation(offset) for offset in range(self.budget.rotations)]

    @cached_property
    def held(self) -> list[Rollout]:
        """Each joint action (as many as the budget allows) held on the first seed."""
        stride = max(len(self.choices) // self.budget.held, 1)
        return [self.hold(action) for action in self.choices[::stride]]

    def policy(self, number: int) -> Rollout:
        """The privileged policy on the episode seed `number`."""
        return Rollout(self.episode_seed(number), [], player="the policy", policy=True, max_steps=self.length)

    @cached_property
    def all(self) -> list[Rollout]:
        """The episodes that several checks share: random, sticky, held and doing nothing."""
        found = [self.random(number) for number in range(self.budget.random)]
        found += [self.sticky(number) for number in range(self.budget.sticky)]
        found += self.held
        if self.contract.noop is not None:
            found += [self.noop(number) for number in range(1, 3)]
        return found

    def earlier(self, rollout: Rollout, found: Rollout | None) -> list[Episode]:
        """Episodes to play before one on the same instance: two at random, before the first episode seed's twice what a
        search has `found`, one of doing nothing to the end and many resets, and last that very episode.
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
        """An episode of actions that are drawn; the same object each time, whose key is made once."""
        wanted = (draw, number, length)
        if wanted not in self._known:
            seed = self.episode_seed(number)
            # Others may be of any size.
            few = self.space["type"] in ("Discrete", "MultiDiscrete")
            drawn = _draw(draw, self._space, seed, length) if few else draw(self.space, seed, length)
            self._known[wanted] = Rollout(seed, drawn, player=player)
        return self._known[wanted]

    @cached_property
    def _space(self) -> str:
        return json.dumps(self.space)


@lru_cache(maxsize=256)
def _draw(draw: _Draw, space: str, seed: int, length: int) -> list[Action]:
    """Environments of one contract are asked to play the same episodes. Nobody changes the list."""
    return draw(json.loads(space), seed, length)
