"""Recall by operator and precision by rule, and whether the limits hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.table import Table

from benchmarks.mutation.operator import OPERATORS
from benchmarks.mutation.results import Result, of_operator
from benchmarks.peers import PEERS

#: The least recall by budget, and the least recall of each operator at the largest.
LEAST = {"quick": 0.85, "standard": 0.95, "thorough": 0.98}
LEAST_OF_EACH = 0.95


def recall(results: Sequence[Result]) -> float:
    """The share of the mutants that count which an error names; 1 where none counts."""
    counted = [result for result in results if result.counts]
    return sum(result.caught for result in counted) / len(counted) if counted else 1.0


def precision(results: Sequence[Result]) -> dict[str, tuple[int, int]]:
    """For each code that was reported as an error: on how many mutants and games, and for how many it is right."""
    reported, right = Counter[str](), Counter[str]()
    for result in results:
        for code in result.errors if result.loads else ():
            reported[code] += 1
            right[code] += bool(result.operator) and OPERATORS[result.operator].names(code)
    return {code: (reported[code], right[code]) for code in sorted(reported)}


def broken(results: Sequence[Result], budget: str) -> list[str]:
    """A line for each limit that does not hold at a budget."""
    mutants = [result for result in results if result.operator]
    lines = []
    if recall(mutants) < LEAST[budget]:
        lines.append(f"{budget}: recall {recall(mutants):.1%} is below {LEAST[budget]:.0%}")
    if budget == "thorough":
        for name in OPERATORS:
            share = recall(of_operator(mutants, name))
            if share < LEAST_OF_EACH:
                lines.append(f"{budget}: recall {share:.1%} of {name} is below {LEAST_OF_EACH:.0%}")
    for result in results:
        if not result.operator and result.verdict != "pass":
            codes = ", ".join(result.errors) or result.verdict
            lines.append(f"{budget}: {result.game} was not changed, and with --seed {result.seed}: {codes}")
    return lines


def by_operator(results: Sequence[Result], budget: str) -> Table:
    """The table of the operators."""
    table = Table(title=f"mutants by operator at {budget}: a share of those that count")
    for column in ("operator", "count", "equivalent", "caught", "any error", "warned", *PEERS):
        table.add_column(column, justify="left" if column == "operator" else "right")
    complained = {result.game: result.peers for result in results if not result.operator and result.peers}
    mutants = [result for result in results if result.operator]
    for name in OPERATORS:
        own = of_operator(mutants, name)
        if own:
            table.add_row(name, *_cells(own, complained))
    table.add_section()
    table.add_row("all", *_cells(mutants, complained))
    return table


def _cells(results: Sequence[Result], complained: dict[str, dict[str, str]]) -> list[str]:
    counted = [result for result in results if result.counts]
    with_peers = [result for result in counted if result.peers]

    def share(number: int, total: int) -> str:
        return f"{number / total:.0%}" if total else "-"

    cells = [str(len(counted)), str(sum(result.equivalent is True for result in results))]
    for number in (
        sum(result.caught for result in counted),
        sum(bool(result.errors) for result in counted),
        sum(result.warned for result in counted),
    ):
        cells.append(share(number, len(counted)))
    for peer in PEERS:
        # A peer has no codes: a complaint that it does not make about the game itself counts.
        new = [result for result in with_peers if result.peers[peer] not in ("", _own(complained, result.game, peer))]
        cells.append(share(len(new), len(with_peers)))
    return cells


def _own(complained: dict[str, dict[str, str]], game: str, peer: str) -> str:
    return complained.get(game, {}).get(peer, "")


def by_rule(results: Sequence[Result], budget: str) -> Table:
    """The table of the rules."""
    table = Table(title=f"precision by rule at {budget}")
    for column in ("code", "reported", "for the planted defect", "precision"):
        table.add_column(column, justify="left" if column == "code" else "right")
    for code, (reported, right) in precision(results).items():
        table.add_row(code, str(reported), str(right), f"{right / reported:.0%}")
    return table
