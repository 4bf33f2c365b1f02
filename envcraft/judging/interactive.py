"""Episodes whose actions an agent or a person chooses one by one."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import deque
from typing import Any, Generic, TypeVar

from envcraft.judging.driver import Stop
from envcraft.judging.subject import Subject
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.model.job import JobResult
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.trace import Trace

_STOP = object()
_Shown = TypeVar("_Shown", bound=TraceBuilder)


class InteractiveEpisode(ABC, Generic[_Shown]):
    """An episode that waits for each action. The thread that runs its job calls :meth:`action_requested`
    (:class:`envcraft.judging.driver.Player`). Always close it.

    Args:
        subject: whose environment is played.
        seed: the seed of the episode.
        conditions: under which it runs.
        player: who chooses the actions, in words.
        steps: the most actions.
        kind: what receives the job's messages.

    Attributes:
        shown: receives the job's messages. Read it while the episode waits, and after its end.
    """

    def __init__(
        self, subject: Subject, seed: int, conditions: Conditions, player: str, steps: int, kind: type[_Shown]
    ) -> None:
        self._subject = subject
        self._actions: deque[Any] = deque()
        self._read, self._write = os.pipe()
        rollout = Rollout(seed, [], conditions, player=player, interactive=True, max_steps=steps)
        self._pending = subject.cache.start(rollout, self, kind)
        assert isinstance(self._pending.builder, kind)
        self.shown: _Shown = self._pending.builder

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self._pending.task.future.done()

    def give(self, action: Any) -> None:
        """Take a step."""
        self._put(action)

    def stop(self) -> None:
        """End the episode here."""
        self._put(_STOP)

    def end(self) -> JobResult:
        """The result of the job after its end. Raises WorkerLost, SandboxUnavailable."""
        ended: JobResult = self._pending.task.future.result()
        return ended

    def finish(self) -> Trace:
        """Wait for the end, and keep the trace. Raises WorkerLost."""
        return self._subject.cache.finish(self._pending)

    def leave(self) -> None:
        """Close the episode and count its steps and time, without keeping its trace."""
        self.close()
        self._subject.cache.discard(self._pending)

    def close(self) -> None:
        """Stop the episode, wait for its end, and close the pipe."""
        self.stop()
        self._pending.task.future.exception()
        os.close(self._read)
        os.close(self._write)

    def _put(self, item: Any) -> None:
        self._actions.append(item)
        os.write(self._write, b".")

    # Called by the job's thread

    @abstractmethod
    def action_requested(self) -> None: ...

    def fileno(self) -> int:
        return self._read

    def take(self) -> Any:
        os.read(self._read, 1)
        item = self._actions.popleft()
        if item is _STOP:
            raise Stop
        return item
