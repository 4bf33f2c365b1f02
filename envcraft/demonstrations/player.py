"""The base classes of players, which plugins offer and ``envcraft demos`` lets play."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.target import PolicyFile
    from envcraft.model.trace import Trace


class Player(ABC):
    """Plays episodes of environments. It has no access to the environment object: it requests rollouts and searches
    from the subject, or provides the text of a policy that runs in the worker beside the environment.

    Attributes:
        name: The value of ``--player``.
        summary: One line for the help.
        families: The families whose environments it can play; empty if it can play any.
        policy: The privileged policy for :meth:`envcraft.judging.subject.Subject.act`.
        version: Changes when the player plays differently under the same name; recordings of different versions are
            stored separately.
    """

    name: str
    summary: str
    families: tuple[str, ...] = ()
    policy: PolicyFile | None = None
    version: str = "1"

    @abstractmethod
    def play(self, subject: Subject, number: int) -> Trace:
        """Play an episode.

        Args:
            subject: The environment.
            number: The number of the episode, which gives its seed (``subject.episode_seed(number)``).

        Returns:
            The trace of the episode.

        Raises:
            Skip: The player cannot play it.
            EnvCraftError: The sandbox fails.
        """

    @property
    def digest(self) -> str:
        """Distinguishes players of the same name."""
        text = self.policy.source if self.policy is not None else self.version
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def plays(self, family: str | None) -> bool:
        """Whether it can play environments of this family."""
        return not self.families or family in self.families


class PolicyPlayer(Player):
    """Plays by a policy: a class with ``act(state)``, or a function ``policy(env)``."""

    def __init__(
        self, policy: PolicyFile, name: str = "policy", summary: str = "", families: tuple[str, ...] = ()
    ) -> None:
        self.policy, self.name, self.summary, self.families = policy, name, summary, families

    def play(self, subject: Subject, number: int) -> Trace:
        return subject.act(number)
