"""An episode whose actions are given one by one, by whoever began it: an agent, or a person at the keys."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import deque
from typing import Any, Generic, TypeVar

from envcraft.recording import Recording
from envcraft.rollout import Conditions, Rollout
from envcraft.sandbox import JobEnd, Stop
from envcraft.subject import Subject
from envcraft.trace import Trace

_STOP = object()
_Shown = TypeVar("_Shown", bound=Recording)


class AskedEpisode(ABC, Generic[_Shown]):
    """An episode of `subject` that waits for actions (:class:`envcraft.sandbox.Player`); its job runs in a lane, whose
    thread calls :meth:`asked`. Close it in any case.

    Attributes:
        shown: what the job has told so far: to be read while the episode waits, and once it is over.
    """

    def __init__(
        self, subject: Subject, seed: int, conditions: Conditions, player: str, steps: int, kind: type[_Shown]
    ) -> None:
        """Begin it. `player` says in words who chooses the actions, of which there are `steps` at the most."""
        self._subject = subject
        self._actions: deque[Any] = deque()
        self._read, self._write = os.pipe()
        rollout = Rollout(seed, [], conditions, player=player, asked=True, max_steps=steps)
        self._begun = subject.begin(rollout, self, kind)
        assert isinstance(self._begun.recording, kind)
        self.shown: _Shown = self._begun.recording

    @property
    def over(self) -> bool:
        """Whether it has ended, however."""
        return self._begun.task.future.done()

    def give(self, action: Any) -> None:
        """Take a step."""
        self._put(action)

    def stop(self) -> None:
        """End it where it is."""
        self._put(_STOP)

    def end(self) -> JobEnd:
        """How the job ended, once it is over. Raises WorkerLost, SandboxUnavailable."""
        ended: JobEnd = self._begun.task.future.result()
        return ended

    def finish(self) -> Trace:
        """Wait for the end, and keep the trace. Raises WorkerLost."""
        return self._subject.finish(self._begun)

    def leave(self) -> None:
        """Close it, and count what it took; its trace is not kept."""
        self.close()
        self._subject.leave(self._begun)

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

    @abstractmethod
    def asked(self) -> None: ...

    def fileno(self) -> int:
        return self._read

    def take(self) -> Any:
        os.read(self._read, 1)
        item = self._actions.popleft()
        if item is _STOP:
            raise Stop
        return item
