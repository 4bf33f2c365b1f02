"""Operating characteristics: how often the statistical rules report, for a true rate and a budget.

The probabilities are exact. They follow from the binomial distribution and from the functions that decide, so nothing
is simulated. ``make docs`` writes the tables into ``docs/statistics.md``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import comb

from envcraft_checks.difficulty import HELD
from envcraft_checks.instadeath import MOST, degenerate_code

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.statistics import Exact, error_of_look, is_above

#: What :func:`envcraft.judging.statistics.settle` promises for all looks together, and half of it for the side that
#: is reported. One interval promises the same.
PROMISED = 0.025
#: The promise for all held actions together.
PROMISED_HELD = 0.05
#: The shares of degenerate seeds that EC703 and EC702 must surely exceed.
DEGENERATE = {"EC703": 0.02, "EC702": 0.05}
#: Lengths of episodes in the tables, in steps.
LENGTHS = (1_000, 100, 10)


def above(rate: float, threshold: float, looks: tuple[int, ...]) -> float:
    """Compute how often the sequential test finds a rate above a threshold.

    The dynamic program of Armitage, McPherson and Rowe (1969, doi:10.2307/2343787) carries the distribution of the
    successes from look to look, without the sequences that are decided.

    Args:
        rate: the true rate of independent trials, from 0 to 1.
        threshold: as in :func:`envcraft.judging.statistics.settle`.
        looks: numbers of trials.

    Returns:
        The probability that :func:`envcraft.judging.statistics.settle` returns True.
    """
    error, found, done = error_of_look(looks), 0.0, 0
    undecided = {0: 1.0}
    for look in looks:
        further = binomial(look - done, rate)
        reached = [0.0] * (look + 1)
        for hits, weight in undecided.items():
            for more, chance in enumerate(further):
                reached[hits + more] += weight * chance
        verdicts = [is_above(Exact(hits, look, error), threshold) for hits in range(look + 1)]
        found += sum(chance for chance, verdict in zip(reached, verdicts, strict=True) if verdict)
        undecided = {hits: reached[hits] for hits, verdict in enumerate(verdicts) if verdict is None}
        done = look
    return found


def degenerate(share: float, seeds: int, codes: Sequence[str]) -> float:
    """Compute how often one of some codes is reported for a true share of degenerate seeds.

    Args:
        share: the true share, from 0 to 1.
        seeds: the seeds that are played.
        codes: of EC702 and EC703.

    Returns:
        The probability.
    """
    chances = enumerate(binomial(seeds, share))
    return sum(chance for hits, chance in chances if degenerate_code(Exact(hits, seeds)) in codes)


def binomial(n: int, rate: float) -> list[float]:
    """Return the probabilities of 0 to `n` successes in `n` trials."""
    return [comb(n, hits) * rate**hits * (1 - rate) ** (n - hits) for hits in range(n + 1)]


def looks() -> str:
    """The table of the longest episodes for which each budget has a look."""
    every = max((budget.looks for budget in BUDGETS.values()), key=len)
    rows = []
    for name, budget in BUDGETS.items():
        cells = []
        for look in every:
            longest = max(steps for steps in range(1, budget.steps) if look in budget.looks_for(steps))
            cells.append("any" if longest == budget.steps - 1 else f"{longest} steps")
        rows.append(f"| `{name}` | " + " | ".join(cells) + " |")
    head = "| budget | " + " | ".join(f"{look} episodes" for look in every) + " |\n"
    return head + "|---" * (1 + len(every)) + "|\n" + "\n".join(rows) + "\n"


def wins() -> str:
    """The table of EC601, EC803, and of EC802 for one held action."""
    return _looked(ARCADE.consistently, (0.7, ARCADE.consistently, 0.85, 0.9, 0.95, 0.99, 1.0))


def losses() -> str:
    """The table of EC701."""
    return _looked(MOST, (0.4, MOST, 0.6, 0.7, 0.8, 0.9, 1.0))


def degenerate_seeds() -> str:
    """The table of EC702 and EC703."""
    columns: dict[str, Callable[[float], float]] = {}
    for name, budget in BUDGETS.items():
        played = budget.session[0]
        columns[f"`{name}`, {played} seeds: EC702"] = partial(degenerate, seeds=played, codes=["EC702"])
        columns[f"`{name}`: EC702 or EC703"] = partial(degenerate, seeds=played, codes=list(DEGENERATE))
    return _table((0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3), columns)


def errors() -> str:
    """The table of the highest probabilities of a false report, next to what is promised."""
    rows = [
        ("EC601, EC803", ARCADE.consistently, PROMISED, wrong(ARCADE.consistently)),
        (f"EC802, {HELD} actions", ARCADE.consistently, PROMISED_HELD, wrong_held()),
        ("EC701", MOST, PROMISED, wrong(MOST)),
        *((code, share, PROMISED, wrong_seeds(code)) for code, share in DEGENERATE.items()),
    ]
    head = "| rule | true rate | promised | " + " | ".join(f"`{name}`" for name in BUDGETS) + " |\n"
    body = [
        f"| {rule} | {rate:.0%} | {promised:.1%} | " + " | ".join(f"{found:.2%}" for found in exact.values()) + " |"
        for rule, rate, promised, exact in rows
    ]
    return head + "|---" * (3 + len(BUDGETS)) + "|\n" + "\n".join(body) + "\n"


def wrong(threshold: float) -> dict[str, float]:
    """How often each budget finds a rate above a threshold that it equals, for the worst length of episodes."""
    return {
        name: max(above(threshold, threshold, budget.looks_for(steps)) for steps in LENGTHS)
        for name, budget in BUDGETS.items()
    }


def wrong_held() -> dict[str, float]:
    """At most how often any held action is reported if each wins as often as is allowed (Bonferroni's inequality)."""
    return {name: HELD * found for name, found in wrong(ARCADE.consistently).items()}


def wrong_seeds(code: str) -> dict[str, float]:
    """How often each budget reports a code, or a worse one, for the share of seeds that it must exceed."""
    codes = ["EC702"] if code == "EC702" else ["EC702", "EC703"]
    return {name: degenerate(DEGENERATE[code], budget.session[0], codes) for name, budget in BUDGETS.items()}


def _looked(threshold: float, rates: Sequence[float]) -> str:
    columns: dict[str, Callable[[float], float]] = {}
    for name, budget in BUDGETS.items():
        designs = {budget.looks_for(steps): steps for steps in reversed(LENGTHS)}
        for looks, steps in sorted(designs.items()):
            length = f" {steps:,} steps," if len(designs) > 1 else ""
            columns[f"`{name}`:{length} {looks[-1]} episodes"] = partial(above, threshold=threshold, looks=looks)
    return _table(rates, columns)


def _table(rates: Sequence[float], columns: dict[str, Callable[[float], float]]) -> str:
    head = "| true rate | " + " | ".join(columns) + " |\n" + "|---" * (1 + len(columns)) + "|\n"
    rows = [f"| {rate:.0%} | " + " | ".join(f"{find(rate):.1%}" for find in columns.values()) + " |" for rate in rates]
    return head + "\n".join(rows) + "\n"


#: The marked blocks of ``docs/statistics.md``, and what writes each.
BLOCKS: dict[str, Callable[[], str]] = {
    "looks": looks,
    "errors": errors,
    "EC601": wins,
    "EC701": losses,
    "EC702": degenerate_seeds,
}
