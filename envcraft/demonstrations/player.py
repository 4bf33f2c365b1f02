"""Who plays for demonstrations: each player is a plugin's, and gives the traces of episodes."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.target import PolicyFile
    from envcraft.trace import Trace


class Player(ABC):
    """Plays episodes of one environment after the other. It sees no environment: it asks the subject for rollouts and
    searches, or gives the text of a policy that runs in the worker, beside the environment.

    Attributes:
        name: how ``--player`` names it.
        summary: one line for the help.
        families: the families whose environments it knows how to play; none: it plays any.
        policy: the privileged policy that :meth:`envcraft.subject.Subject.act` is to play by.
        version: another one where the same name plays otherwise: recordings are kept apart by it.
    """

    name: str
    summary: str
    families: tuple[str, ...] = ()
    policy: PolicyFile | None = None
    version: str = "1"

    @abstractmethod
    def play(self, subject: Subject, number: int) -> Trace:
        """The episode with this number, on its seed (``subject.episode_seed(number)``). Raises Skip, EnvCraftError."""

    @property
    def digest(self) -> str:
        """What tells two players of one name apart."""
        text = self.policy.source if self.policy is not None else self.version
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def plays(self, family: str | None) -> bool:
        """Whether it knows how to play environments of this family."""
        return not self.families or family in self.families


class PolicyPlayer(Player):
    """Plays by a policy: a class with ``act(state)``, or a function ``policy(env)``."""

    def __init__(
        self, policy: PolicyFile, name: str = "policy", summary: str = "", families: tuple[str, ...] = ()
    ) -> None:
        self.policy, self.name, self.summary, self.families = policy, name, summary, families

    def play(self, subject: Subject, number: int) -> Trace:
        return subject.act(number)
