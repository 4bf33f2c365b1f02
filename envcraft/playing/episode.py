"""One episode that a person plays: the job in a lane's thread, the person in this one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from envcraft.asked import AskedEpisode
from envcraft.frames import rgb
from envcraft.recording import Recording
from envcraft.reports import one_line
from envcraft.rollout import Conditions
from envcraft.sandbox import Step

if TYPE_CHECKING:
    from envcraft.subject import Subject

    from .picture import Picture

_MOST_TEXT = 2000


class Watched(Recording):
    """A recording that keeps what there is to see now: the last frame, else the last observation in words."""

    picture: Picture | None = None
    text: str = ""

    def reset(self, step: Step) -> None:
        super().reset(step)
        self._look(step.layout, step.data)

    def step(self, step: Step) -> None:
        super().step(step)
        self._look(step.layout, step.data)

    def render(self, layout: int, data: memoryview) -> None:
        super().render(layout, data)
        self._look(layout, data)

    def _look(self, number: int, data: memoryview) -> None:
        value = self._layout(number).decode(data)
        frame = rgb(value) if isinstance(value, np.ndarray) else None
        if frame is not None:
            # The bytes are only there during the call.
            self.picture = frame.copy()
        else:
            self.text = one_line(value)[:_MOST_TEXT]


class Episode(AskedEpisode[Watched]):
    """An episode that a person plays: `waiting` says whether it wants an action now."""

    def __init__(self, subject: Subject, seed: int, conditions: Conditions, steps: int) -> None:
        self.seed = seed
        self.waiting = False
        super().__init__(subject, seed, conditions, "a person", steps, Watched)

    def give(self, action: Any) -> None:
        self.waiting = False
        super().give(action)

    def asked(self) -> None:
        self.waiting = True
