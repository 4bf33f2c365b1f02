"""Stages: how an idea becomes an environment, step by step; ``envcraft generate --concepts`` runs them in their order.

A stage is given a :class:`Case`, which is all that is known of one concept, and a :class:`Workbench`, which asks
models, judges in the sandbox and keeps what was made. It gives an :class:`Outcome`, which is counted and kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from envcraft.errors import UsageError
from envcraft.verdict import SubjectReport

#: What becomes of a concept in a stage: it goes on, it is no good, or nothing came of the attempt to find out.
Result = Literal["passed", "rejected", "failed"]


class Outcome(msgspec.Struct, frozen=True):
    """What a stage said of a concept.

    Attributes:
        result: only what has ``passed`` comes to the next stage.
        reason: why not, in one line that begins with words that are the same for the same cause, up to a colon.
        facts: plain data that is kept with it.
    """

    result: Result
    reason: str = ""
    facts: dict[str, Any] = {}


class Question(msgspec.Struct, frozen=True):
    """What a stage asks a model.

    Attributes:
        messages: the conversation so far, as pairs of a role (``system``, ``user``, ``assistant``) and a text.
        stage: who asks.
        attempt: which attempt at the concept this is, from 0.
        schema: the JSON Schema that the answer should follow, None for text.
        prompt: the SHA-256 of the template that the messages were made from.
        sample: tells apart questions that are otherwise the same, and are to be answered anew.
    """

    messages: tuple[tuple[str, str], ...]
    stage: str
    attempt: int = 0
    schema: dict[str, Any] | None = None
    prompt: str = ""
    sample: int = 0


class Reply(msgspec.Struct, frozen=True):
    """What a model answered; `cut` where a limit ended it, `provenance` says which request to which model it was."""

    text: str
    cut: bool = False
    provenance: dict[str, Any] = {}


class Attempt(msgspec.Struct):
    """One source for a concept, and what the checks say of it.

    Attributes:
        number: 0 for the first source, then one for each repair.
        source: the text of the file.
        env_class: which class of the file it is, "" where there is one.
        diff: from the attempt that it repairs, as a unified diff.
        report: of all checks, None before it was judged as this run judges.
        profile: what it does under play that is the same for all attempts, in numbers.
        gutted: how it passes by doing less than it was meant to, "" where it does not.
        provenance: which requests it comes from.
    """

    number: int
    source: str
    env_class: str = ""
    diff: str = ""
    report: SubjectReport | None = None
    profile: dict[str, Any] = {}
    gutted: str = ""
    provenance: dict[str, Any] = {}


class PolicyTry(msgspec.Struct):
    """One privileged policy for a concept: it wins `wins` of `episodes`; `fault` says what is wrong with it, if so."""

    number: int
    source: str
    wins: int = 0
    episodes: int = 0
    fault: str = ""
    provenance: dict[str, Any] = {}


@dataclass
class Case:
    """All that is known of one concept.

    Attributes:
        concept: its id.
        title: of the game.
        idea: the concept's text.
        data: the concept as plain data.
        brief: the design document, "" before there is one.
        attempts: the sources so far, in order.
        policies: the privileged policies so far, in order.
        outcomes: of the stages that it has been through.
    """

    concept: str
    title: str
    idea: str
    data: dict[str, Any] = field(default_factory=dict)
    brief: str = ""
    attempts: list[Attempt] = field(default_factory=list)
    policies: list[PolicyTry] = field(default_factory=list)
    outcomes: dict[str, Outcome] = field(default_factory=dict)

    @property
    def best(self) -> Attempt | None:
        """The last attempt that does what it was meant to."""
        return next((attempt for attempt in reversed(self.attempts) if not attempt.gutted), None)


class Played(msgspec.Struct, frozen=True):
    """How a privileged policy does: the report of the check ``difficulty``, and how often the policy wins."""

    report: SubjectReport
    wins: int
    episodes: int


class Workbench(ABC):
    """What a stage works with. What is kept is on disk when the method comes back.

    An exception of any of these methods is for the pipeline to count: let it pass.
    """

    @abstractmethod
    async def ask(self, case: Case, question: Question) -> Reply:
        """A model's answer."""

    @abstractmethod
    async def judge(self, case: Case, attempt: Attempt) -> None:
        """Judge an attempt by all checks: sets its `report` and `profile`."""

    @abstractmethod
    async def play(self, case: Case, attempt: Attempt, policy: str) -> Played:
        """Let the source of a privileged policy play an attempt's environment."""

    @abstractmethod
    def keep_brief(self, case: Case, text: str, provenance: dict[str, Any]) -> None:
        """Make this the concept's brief."""

    @abstractmethod
    def keep_attempt(self, case: Case, attempt: Attempt) -> None:
        """Add an attempt, or put it in the place of the one with its number."""

    @abstractmethod
    def drop_attempts(self, case: Case, number: int) -> None:
        """Forget the attempts from this number on: what comes now takes their place."""

    @abstractmethod
    def keep_policy(self, case: Case, policy: PolicyTry) -> None:
        """Add a privileged policy, or put it in the place of the one with its number."""

    @abstractmethod
    def publish(self, case: Case, attempt: Attempt) -> str:
        """Make an attempt an environment of the corpus; give its name."""


class Stage(ABC):
    """One step on the way from a concept to an environment.

    Attributes:
        name: how ``--from`` and ``--until`` name it, in lower case.
        summary: one line for people.
        after: the stage that comes before this one; "" for the first.
        replaces: the stage whose place this one takes; "" for one that comes in addition.
        optional: whether it runs only where ``--with`` names it.
    """

    name: str
    summary: str
    after: str = ""
    replaces: str = ""
    optional: bool = False

    @abstractmethod
    async def run(self, case: Case, bench: Workbench) -> Outcome:
        """Take one concept through. May be ended anywhere, and is then run again from the start with what was kept."""


def ordered(stages: Sequence[Stage]) -> list[Stage]:
    """Stages in the order in which they run; those that come after the same one, in the order in which they are given.
    Raises UsageError where a stage names one that there is not, or one that comes after itself.
    """
    replaced = {stage.replaces: stage for stage in stages if stage.replaces}
    standing = {stage.name: stage for stage in stages if stage.name not in replaced}
    known = {stage.name for stage in stages}
    for stage in stages:
        for named in (stage.replaces, stage.after):
            if named and named not in known:
                raise UsageError(f"the stage {stage.name} goes with a stage {named}, and there is none")
    after: dict[str, list[Stage]] = {}
    for stage in standing.values():
        # In the place of another it comes where that one came.
        place = stage.after or next((old.after for old in stages if old.name == stage.replaces), "")
        place = replaced[place].name if place in replaced else place
        after.setdefault(place, []).append(stage)
    found = list(_chain("", after))
    if lost := [name for name, stage in standing.items() if stage not in found]:
        raise UsageError(f"the stages {', '.join(lost)} come after each other in a circle")
    return found


def _chain(name: str, after: dict[str, list[Stage]]) -> Iterable[Stage]:
    # What is added stands between a stage and the one that has followed it so far.
    for stage in sorted(after.get(name, ()), key=lambda stage: bool(after.get(stage.name))):
        yield stage
        yield from _chain(stage.name, after)
