"""The order in which pieces come, how many of the next are shown."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft

from .pieces import Pieces

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

ORDERS = ("bag", "double bag", "uniform", "weighted", "history")


@dataclass(frozen=True)
class Supply:
    """`weights` are those of the pieces where the order is weighted; `memory` and `tries` belong to history."""

    order: str
    preview: int
    weights: tuple[int, ...] = ()
    memory: int = 0
    tries: int = 0

    @classmethod
    def draw(cls, rng: Random, pieces: Pieces) -> Supply:
        order = rng.choice(ORDERS)
        preview = rng.choices((0, 1, 2, 3), (3, 4, 2, 2))[0]
        if order == "weighted":
            weights = [rng.choice((1, 1, 2, 3, 5)) for _ in pieces.art]
            weights[rng.randrange(len(weights))] += 1
            return cls(order, preview, weights=tuple(weights))
        if order == "history":
            return cls(order, preview, memory=1 if len(pieces.art) < 5 else rng.randint(1, 4), tries=rng.randint(2, 6))
        return cls(order, preview)

    def write(self, draft: Draft, variant: Variant) -> None:
        {"bag": self._bag, "double bag": self._bag, "weighted": self._weighted, "history": self._history}.get(
            self.order, self._uniform
        )(draft)
        if not self.preview:
            draft.add("next", "self._draw_kind()")
            return
        shown = "next piece is" if self.preview == 1 else f"next {self.preview} pieces are"
        draft.add("story", f"The {shown} shown in the panel.")
        draft.add("constants", f"PREVIEW = {self.preview}")
        draft.add("queue", "self.queue = [self._draw_kind() for _ in range(PREVIEW)]")
        draft.add("next", "self._take_next()")
        draft.add(
            "methods",
            """
            def _take_next(self) -> int:
                self.queue.append(self._draw_kind())
                return self.queue.pop(0)
            """,
        )

    def _bag(self, draft: Draft) -> None:
        copies = 2 if self.order == "double bag" else 1
        times = "twice" if copies == 2 else "once"
        draft.add("story", f"They come out of a bag that holds each {times} and is filled anew when it is empty.")
        if copies == 2:
            draft.add("constants", "COPIES = 2")
        draft.add("reset", "self.bag: list[int] = []")
        count = "COPIES * len(PIECES)" if copies == 2 else "len(PIECES)"
        drawn = "self.bag.pop() % len(PIECES)" if copies == 2 else "self.bag.pop()"
        draft.add(
            "methods",
            f"""
            def _draw_kind(self) -> int:
                if not self.bag:
                    self.bag = self.np_random.permutation({count}).tolist()
                return {drawn}
            """,
        )

    def _uniform(self, draft: Draft) -> None:
        draft.add("story", "Each comes by chance.")
        draft.add(
            "methods",
            """
            def _draw_kind(self) -> int:
                return int(self.np_random.integers(len(PIECES)))
            """,
        )

    def _weighted(self, draft: Draft) -> None:
        draft.add("story", "Some come more often than others.")
        weights = ", ".join(map(str, self.weights))
        draft.add("tables", "# How often each piece comes, relative to the others.", f"WEIGHTS = ({weights})")
        draft.add("tables", "LOTS = [kind for kind, weight in enumerate(WEIGHTS) for _ in range(weight)]")
        draft.add(
            "methods",
            """
            def _draw_kind(self) -> int:
                return LOTS[int(self.np_random.integers(len(LOTS)))]
            """,
        )

    def _history(self, draft: Draft) -> None:
        last = "the last one" if self.memory == 1 else f"any of the last {self.memory}"
        draft.add("story", f"They come by chance; a piece like {last} is put back, up to {self.tries - 1} times.")
        draft.add("constants", f"MEMORY, TRIES = {self.memory}, {self.tries}")
        draft.add("reset", "self.recent = [-1] * MEMORY")
        draft.add(
            "methods",
            """
            def _draw_kind(self) -> int:
                kind = int(self.np_random.integers(len(PIECES)))
                for _ in range(TRIES - 1):
                    if kind not in self.recent:
                        break
                    kind = int(self.np_random.integers(len(PIECES)))
                self.recent = [*self.recent[1:], kind]
                return kind
            """,
        )
