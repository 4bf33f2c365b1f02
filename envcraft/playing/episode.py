"""One episode that a person plays: the job in a lane's thread, the person in this one."""

from __future__ import annotations

import os
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from envcraft.frames import rgb
from envcraft.reports import one_line
from envcraft.rollout import Conditions, Rollout
from envcraft.sandbox import Step, Stop
from envcraft.trace import Recording, Trace

if TYPE_CHECKING:
    from envcraft.subject import Subject

    from .picture import Picture

_STOP = object()
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


class Episode:
    """An episode of `subject` that waits for actions (:class:`envcraft.sandbox.Player`). Close it in any case."""

    def __init__(self, subject: Subject, seed: int, conditions: Conditions, steps: int) -> None:
        self.seed = seed
        self.waiting = False
        self._subject = subject
        self._actions: deque[Any] = deque()
        self._read, self._write = os.pipe()
        rollout = Rollout(seed, [], conditions, player="a person", asked=True, max_steps=steps)
        self._begun = subject.begin(rollout, self, Watched)

    @property
    def over(self) -> bool:
        """Whether it has ended, however."""
        return self._begun.task.future.done()

    @property
    def watched(self) -> Watched:
        """What is to be seen: to be read while the episode waits, and once it is over."""
        assert isinstance(self._begun.recording, Watched)
        return self._begun.recording

    def give(self, action: Any) -> None:
        """Take a step."""
        self.waiting = False
        self._put(action)

    def stop(self) -> None:
        """End it where it is."""
        self._put(_STOP)

    def finish(self) -> Trace:
        """Wait for the end. Raises WorkerLost."""
        return self._subject.finish(self._begun)

    def close(self) -> None:
        """Stop it, wait for that, and let go of the pipe."""
        self.stop()
        self._begun.task.future.exception()
        os.close(self._read)
        os.close(self._write)

    def _put(self, item: Any) -> None:
        self._actions.append(item)
        os.write(self._write, b".")

    # What the job's thread calls

    def asked(self) -> None:
        self.waiting = True

    def fileno(self) -> int:
        return self._read

    def take(self) -> Any:
        os.read(self._read, 1)
        item = self._actions.popleft()
        if item is _STOP:
            raise Stop
        return item
