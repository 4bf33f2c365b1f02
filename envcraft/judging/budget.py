"""How much a validation spends, in environment steps, so that a verdict never depends on the machine's speed."""

from __future__ import annotations

import msgspec

#: The looks of all budgets.
_LOOKS = (6, 12, 24, 48, 96)
#: The part of the steps that the episodes of an additional look may take: one in so many.
_PART = 4


class Budget(msgspec.Struct, frozen=True):
    """What ``--budget`` names.

    Where a number of steps is shared by several episodes, each is cut at its share. Short episodes leave their rest to
    the following ones, so a game with short episodes is played more often than one with long episodes.

    Attributes:
        steps: environment steps of every kind for a game whose episodes last 1,000 steps.
        play: steps of the episodes that several checks share.
        random: episodes of random play.
        sticky: episodes of random actions, each held for a while.
        held: joint actions that are held throughout an episode.
        rotations: episodes that together try every joint action at every step.
        inspected: steps of the episode whose every value and call is inspected.
        probes: seeds on which determinism is probed, and the most steps of each probe.
        earlier: steps of a random earlier episode on the same instance.
        wins: how often a short win is played before an episode on the same instance.
        beside: steps of a second instance that is stepped alongside.
        session: of many short episodes on one instance: the seeds, the steps of an episode, how often one of them is
            repeated, and the steps of the last one.
        onward: steps of the episodes that go on after an event, and the number of these episodes.
        explore: the fewest and the most steps of a search for crashes and wins, and the seeds that are searched.
        exhaust: the most steps of a search through all reachable states.
        sweep: the most steps spent on rare actions along the longest episode and the best one.
        policy: episodes of the privileged policy that are examined step by step.
        looks: numbers of episodes after which a statistical verdict is looked at; see :meth:`looks_for`.
        length: steps of an episode under a contract without a limit.
        seconds: the longest time of one subject on the clock, unless ``--time-limit`` names another.
    """

    name: str
    steps: int
    play: int
    random: int
    sticky: int
    held: int
    rotations: int
    inspected: int
    probes: tuple[int, int]
    earlier: int
    wins: int
    beside: int
    session: tuple[int, int, int, int]
    onward: tuple[int, int]
    explore: tuple[int, int, int]
    exhaust: int
    sweep: int
    policy: int
    looks: tuple[int, ...]
    length: int
    seconds: float = 600.0

    def looks_for(self, steps: int) -> tuple[int, ...]:
        """Return the numbers of episodes after which a statistical verdict is looked at.

        Short episodes have more looks than `looks`, and all budgets have the same ones in the same order. So a larger
        budget cannot decide differently where a smaller one has decided.

        Args:
            steps: the length of an episode.

        Returns:
            `looks`, and each later look of any budget whose episodes together take at most a quarter of `self.steps`.
        """
        return tuple(look for look in _LOOKS if look <= self.looks[-1] or _PART * look * steps <= self.steps)


BUDGETS = {
    budget.name: budget
    for budget in (
        Budget(
            "quick",
            steps=5_000,
            play=2_400,
            random=2,
            sticky=1,
            held=7,
            rotations=0,
            inspected=100,
            probes=(1, 60),
            earlier=25,
            wins=3,
            beside=60,
            session=(40, 2, 12, 15),
            onward=(200, 2),
            explore=(650, 2_000, 1),
            exhaust=2_000,
            sweep=0,
            policy=1,
            looks=_LOOKS[:3],
            length=300,
            seconds=120.0,
        ),
        Budget(
            "standard",
            steps=20_000,
            play=13_200,
            random=6,
            sticky=3,
            held=20,
            rotations=20,
            inspected=250,
            probes=(2, 120),
            earlier=60,
            wins=10,
            beside=60,
            session=(100, 3, 16, 60),
            onward=(1_400, 3),
            explore=(900, 6_000, 2),
            exhaust=20_000,
            sweep=4_000,
            policy=2,
            looks=_LOOKS[:3],
            length=1_000,
        ),
        Budget(
            "thorough",
            steps=100_000,
            play=57_000,
            random=24,
            sticky=12,
            held=20,
            rotations=60,
            inspected=1_000,
            probes=(6, 500),
            earlier=200,
            wins=20,
            beside=200,
            session=(200, 3, 24, 200),
            onward=(5_600, 12),
            explore=(3_000, 40_000, 6),
            exhaust=100_000,
            sweep=40_000,
            policy=3,
            looks=_LOOKS,
            length=2_000,
            seconds=3_600.0,
        ),
    )
}
