"""Read the spaces of an instance again while it is played: they must answer at any time, and stay equal."""

from __future__ import annotations

from typing import Any

import gymnasium
from envcraft_protocol.spaces import describe
from envcraft_protocol.wire import Kind

from .subject import Subject

_Space = gymnasium.Space
_SHOWN = 300


class Spaces:
    """The spaces that an instance had first.

    Args:
        subject: reads them.
        env: the instance.
        everything: notice changes inside an observation space, too, whose description may take as long as a step.
    """

    def __init__(self, subject: Subject, env: Any, everything: bool) -> None:
        self._subject = subject
        self._env = env
        #: By name: the space, its description if changes inside are noticed, and its text.
        self._first: dict[str, tuple[Any, Any, str]] = {}
        for name in ("observation_space", "action_space"):
            space = self._read(name)
            if isinstance(space, _Space):
                described = self._describe(space) if everything or name == "action_space" else None
                self._first[name] = space, described, self._text(space)

    def check(self) -> None:
        """Read the spaces, and report each that differs from the first one, once."""
        for name, (first, described, text) in list(self._first.items()):
            space = self._read(name)
            if space is first and described is None:
                continue
            if self._describe(space) != (described or self._describe(first)):
                del self._first[name]
                report = {"name": name, "before": text, "now": self._text(space)}
                self._subject.channel.send_json(Kind.SPACE, report)
            else:
                # Environments may make an equal space at each reset.
                self._first[name] = space, described, text

    def _read(self, name: str) -> Any:
        return self._subject.call("spaces", getattr, self._env, name, None)

    def _describe(self, space: Any) -> Any:
        return self._subject.call("spaces", describe, space)

    def _text(self, space: Any) -> str:
        return str(self._subject.call("spaces", str, space))[:_SHOWN]
