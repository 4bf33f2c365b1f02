"""One episode that a person plays: the job runs in a worker thread, the person plays in this one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from envcraft.judging.driver import Step
from envcraft.judging.frame_renderer import rgb
from envcraft.judging.interactive import InteractiveEpisode
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.model.rollout import Conditions
from envcraft.text import one_line

if TYPE_CHECKING:
    from envcraft.cli.play.picture import Picture
    from envcraft.judging.subject import Subject

_MOST_TEXT = 2000


class Watched(TraceBuilder):
    """A trace builder that keeps what to show: the last frame, or the last observation as text."""

    picture: Picture | None = None
    text: str = ""

    def reset(self, step: Step) -> None:
        super().reset(step)
        self._look(step.layout, step.data, step.digest)

    def step(self, step: Step) -> None:
        super().step(step)
        self._look(step.layout, step.data, step.digest)

    def render(self, layout: int, data: memoryview, digest: bytes = b"") -> None:
        super().render(layout, data, digest)
        self._look(layout, data, digest)

    def _look(self, number: int, data: memoryview, digest: bytes) -> None:
        value = self._decode(number, data, digest)
        frame = rgb(value) if isinstance(value, np.ndarray) else None
        if frame is not None:
            self.picture = frame
        else:
            self.text = one_line(value)[:_MOST_TEXT]


class Episode(InteractiveEpisode[Watched]):
    """An episode that a person plays; `waiting` says whether it needs an action."""

    def __init__(self, subject: Subject, seed: int, conditions: Conditions, steps: int) -> None:
        self.seed = seed
        self.waiting = False
        super().__init__(subject, seed, conditions, "a person", steps, Watched)

    def give(self, action: Any) -> None:
        self.waiting = False
        super().give(action)

    def action_requested(self) -> None:
        self.waiting = True
