"""How much a validation spends, in episodes and steps, so that a verdict never depends on the machine's speed."""

from __future__ import annotations

import msgspec


class Budget(msgspec.Struct, frozen=True):
    """What ``--budget`` names.

    Attributes:
        random: random episodes that every statistical check starts from.
        sticky: episodes of random actions, each held for a while.
        held: how many joint actions are held for a whole episode.
        rotations: episodes that together try every joint action at every step.
        probes: seeds on which determinism is probed, and the steps of each probe.
        explore: steps of a search for crashes and wins, and the seeds that are searched.
        exhaust: steps of a search through all reachable states.
        sweep: steps spent on trying rare actions along the longest episode and the best one.
        looks: numbers of episodes after which a statistical verdict is looked at.
        steps: the length of an episode under a contract without a limit.
        seconds: the longest time of one subject on the clock, unless ``--time-limit`` names another.
    """

    name: str
    random: int
    sticky: int
    held: int
    rotations: int
    probes: tuple[int, int]
    explore: tuple[int, int]
    exhaust: int
    sweep: int
    looks: tuple[int, ...]
    steps: int
    seconds: float = 600.0


BUDGETS = {
    budget.name: budget
    for budget in (
        Budget("quick", 3, 1, 8, 0, (1, 200), (2_000, 1), 2_000, 0, (6, 12, 24), 300, 120.0),
        Budget("standard", 6, 3, 20, 20, (3, 500), (6_000, 2), 20_000, 4_000, (6, 12, 24), 1_000),
        Budget(
            "thorough", 24, 12, 20, 60, (8, 1_000), (40_000, 6), 100_000, 40_000, (6, 12, 24, 48, 96), 2_000, 3600.0
        ),
    )
}
