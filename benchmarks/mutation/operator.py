"""What a mutation operator is, and the list of all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from benchmarks.mutation.source import Edit, Source

#: The edits of each place where an operator applies.
Places = Iterator[Sequence[Edit]]


@dataclass(frozen=True)
class Operator:
    """One kind of defect.

    Attributes:
        name: of the operator.
        description: what it does to a game.
        codes: the codes that name the defect; "EC20" stands for all codes that begin so.
        places: yields the edits for each place of a game where it applies.
        silent: no trace shows the defect, for example a leak, so replay cannot prove a mutant equivalent.
        warns: a good game may do the same, so the rules that name the defect only warn, and a warning counts.
    """

    name: str
    description: str
    codes: tuple[str, ...]
    places: Callable[[Source], Places]
    silent: bool = False
    warns: bool = False

    def mutants(self, game: Source) -> list[str]:
        """The texts of the game's mutants, without repetitions."""
        texts = [game.edited(edits) for edits in self.places(game)]
        return [text for text in dict.fromkeys(texts) if text != game.text]

    def names(self, code: str) -> bool:
        """Whether a code names this defect."""
        return code.startswith(self.codes)


OPERATORS: dict[str, Operator] = {}


def operator(
    *codes: str, silent: bool = False, warns: bool = False
) -> Callable[[Callable[[Source], Places]], Callable[[Source], Places]]:
    """Register a function as an operator: its name and its docstring are the operator's."""

    def register(places: Callable[[Source], Places]) -> Callable[[Source], Places]:
        OPERATORS[places.__name__] = Operator(
            places.__name__, (places.__doc__ or "").strip(), codes, places, silent, warns
        )
        return places

    return register
