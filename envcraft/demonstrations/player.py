"""The base classes of players, which plugins offer and ``envcraft demos`` lets play."""

from __future__ import annotations

import hashlib
import re
from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.errors import Skip, UsageError
from envcraft.model.target import PolicyFile, read_policy
from envcraft.registry import offered
from envcraft.text import one_line

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.rollout import Action
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

    def advise(self, subject: Subject, seed: int, actions: list[Action]) -> list[Action]:
        """Say what the player would do in each state of an episode that another player played.

        Imitation learning labels the learner's own states with it (Ross et al. 2011, arXiv:1011.0686).

        Args:
            subject: The environment.
            seed: The seed of the episode.
            actions: The actions that the other player took.

        Returns:
            An action for each of them.

        Raises:
            Skip: The player cannot advise, or the episode is cut short.
            EnvCraftError: The sandbox fails.
        """
        raise Skip(f"the player {self.name} does not advise on episodes of other players")

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

    def advise(self, subject: Subject, seed: int, actions: list[Action]) -> list[Action]:
        trace = subject.advised(seed, actions)
        if trace.steps < len(actions) or trace.refused:
            broken = trace.refused or trace.fault or trace.ending
            raise Skip(f"{self.name} advises on {trace.steps} of {len(actions)} steps on seed {seed}: {broken}")
        return list(trace.chosen)


class PlayerLoader(ABC):
    """Makes players from files, such as the policies of a trainer. A user names such a player as ``NAME:PATH``.

    Attributes:
        name: The kind of player, before the colon.
        summary: One line for the help.
    """

    name: str
    summary: str

    @abstractmethod
    def load(self, path: Path) -> Player:
        """Make a player, which imports its libraries when it plays.

        Args:
            path: The file or folder.

        Raises:
            UsageError: It is not of this kind.
        """


def loaded_player(name: str) -> Player:
    """Make the player with this name, such as ``checkpoint:PATH``.

    Raises:
        UsageError: No plugin loads such players, or the file is not of this kind.
    """
    kind, _, path = name.partition(":")
    loaders = {loader.name: loader for loader in offered("envcraft_player_loaders")}
    if kind not in loaders or not path:
        known = " or ".join(f"{loader}:PATH" for loader in loaders)
        raise UsageError(f"there is no player {one_line(name)}" + (f"; write it as {known}" if known else ""))
    loader: PlayerLoader = loaders[kind]
    return loader.load(Path(path))


def policy_named(name: str) -> PolicyFile:
    """The privileged policy in a file, or that of the player with this name.

    Raises:
        UsageError: There is neither, or the file cannot be read.
    """
    if not Path(name).exists():
        policies = {player.name: player.policy for player in offered("envcraft_players")}
        if (policy := policies.get(name)) is not None:
            return PolicyFile(name, policy.source)
    return read_policy(name)


_PLANNING = Path(__file__).with_name("planning.py")
#: What a policy's text leaves out after the text of the planner: its import, and the import that must come first.
_LEFT_OUT = re.compile(
    r"^from (?:envcraft\.demonstrations\.planning import (?:\([^)]*\)|[^\n(]*)|__future__ import annotations)\n", re.M
)


def policy_with_planning(file: Path) -> PolicyFile:
    """Read a policy that imports :mod:`envcraft.demonstrations.planning`, as one text that imports nothing of EnvCraft.

    The policy's class must be the last of its file that has a method ``act``.

    Raises:
        OSError: The file cannot be read.
    """
    own = _LEFT_OUT.sub("", file.read_text("utf-8"))
    return PolicyFile(str(file), f"{_PLANNING.read_text('utf-8')}\n\n{own}")
