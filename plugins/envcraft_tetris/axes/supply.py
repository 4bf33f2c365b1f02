"""The order of pieces, and the size of the preview."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.pieces import Pieces

ORDERS = ("bag", "double bag", "uniform", "weighted", "history")


@dataclass(frozen=True)
class Supply:
    """The order. `weights` belong to the order `weighted`; `memory` and `tries` belong to `history`."""

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

    def write(self, code: SourceBuilder) -> None:
        {"bag": self._bag, "double bag": self._bag, "weighted": self._weighted, "history": self._history}.get(
            self.order, self._uniform
        )(code)
        if not self.preview:
            code.add("next", "self._draw_kind()")
            return
        shown = "next piece is" if self.preview == 1 else f"next {self.preview} pieces are"
        code.add("story", f"The {shown} shown in the panel.")
        code.add("constants", f"PREVIEW = {self.preview}")
        code.add("queue", "self.queue = [self._draw_kind() for _ in range(PREVIEW)]")
        code.add("next", "self._take_next()")
        code.add(
            "methods",
            """
            def _take_next(self) -> int:
                self.queue.append(self._draw_kind())
                return self.queue.pop(0)
            """,
        )

    def _bag(self, code: SourceBuilder) -> None:
        copies = 2 if self.order == "double bag" else 1
        times = "twice" if copies == 2 else "once"
        code.add("story", f"They come out of a bag that holds each {times} and is filled anew when it is empty.")
        if copies == 2:
            code.add("constants", "COPIES = 2")
        code.add("reset", "self.bag: list[int] = []")
        count = "COPIES * len(PIECES)" if copies == 2 else "len(PIECES)"
        drawn = "self.bag.pop() % len(PIECES)" if copies == 2 else "self.bag.pop()"
        code.add(
            "methods",
            f"""
            def _draw_kind(self) -> int:
                if not self.bag:
                    self.bag = self.np_random.permutation({count}).tolist()
                return {drawn}
            """,
        )

    def _uniform(self, code: SourceBuilder) -> None:
        code.add("story", "Each comes by chance.")
        code.add(
            "methods",
            """
            def _draw_kind(self) -> int:
                return int(self.np_random.integers(len(PIECES)))
            """,
        )

    def _weighted(self, code: SourceBuilder) -> None:
        code.add("story", "Some come more often than others.")
        weights = ", ".join(map(str, self.weights))
        code.add("tables", "# How often each piece comes, relative to the others.", f"WEIGHTS = ({weights})")
        code.add("tables", "LOTS = [kind for kind, weight in enumerate(WEIGHTS) for _ in range(weight)]")
        code.add(
            "methods",
            """
            def _draw_kind(self) -> int:
                return LOTS[int(self.np_random.integers(len(LOTS)))]
            """,
        )

    def _history(self, code: SourceBuilder) -> None:
        last = "the last one" if self.memory == 1 else f"any of the last {self.memory}"
        code.add("story", f"They come by chance; a piece like {last} is put back, up to {self.tries - 1} times.")
        code.add("constants", f"MEMORY, TRIES = {self.memory}, {self.tries}")
        code.add("reset", "self.recent = [-1] * MEMORY")
        code.add(
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
