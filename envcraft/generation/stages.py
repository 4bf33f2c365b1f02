"""Stages: the steps from a concept to an environment, which ``envcraft generate --concepts`` runs in order.

A stage gets a :class:`ConceptState`, which holds everything known about one concept, and a :class:`StageContext`, which
calls models, judges environments in the sandbox and stores what the stage makes. It returns a :class:`StageOutcome`,
which is counted and stored.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from envcraft.model.verdict import SubjectReport

#: The result of a stage: the concept continues, the concept is bad, or the stage came to no answer.
Result = Literal["passed", "rejected", "failed"]


class StageOutcome(msgspec.Struct, frozen=True):
    """The outcome of a stage for one concept.

    Attributes:
        result: Only a concept that ``passed`` reaches the next stage.
        reason: Why it did not pass, in one line. The words before the first colon are the same for the same cause.
        facts: Plain data that is stored with the outcome.
    """

    result: Result
    reason: str = ""
    facts: dict[str, Any] = {}


class StageRequest(msgspec.Struct, frozen=True):
    """A request of a stage to a model.

    Attributes:
        messages: The conversation so far, as pairs of role (``system``, ``user``, ``assistant``) and text.
        stage: Name of the stage.
        attempt: Number of the attempt at the concept, from 0.
        schema: JSON Schema of the completion, or None for text.
        prompt: SHA-256 of the template that the messages were made from.
        sample: Distinguishes requests that are otherwise equal.
    """

    messages: tuple[tuple[str, str], ...]
    stage: str
    attempt: int = 0
    schema: dict[str, Any] | None = None
    prompt: str = ""
    sample: int = 0


class StageReply(msgspec.Struct, frozen=True):
    """The completion of a stage's request.

    Attributes:
        text: The text.
        cut: Whether a token limit cut it off.
        provenance: The model, and the digests of the request and the prompt.
    """

    text: str
    cut: bool = False
    provenance: dict[str, Any] = {}


class Attempt(msgspec.Struct):
    """One source for a concept, and how it was judged.

    Attributes:
        number: 0 for the first source; each repair adds one.
        source: Text of the file.
        env_class: Class in the file that is the environment; "" if there is only one.
        diff: Unified diff from the attempt that it repairs.
        report: Report of all checks; None if it was not judged under the settings of this run.
        profile: Statistics of its behaviour under the episodes that every attempt plays.
        degenerate: Why the repair is degenerate, that is, passes by doing less than the attempts before; else "".
        provenance: The requests that it comes from.
    """

    number: int
    source: str
    env_class: str = ""
    diff: str = ""
    report: SubjectReport | None = None
    profile: dict[str, Any] = {}
    degenerate: str = ""
    provenance: dict[str, Any] = {}


class PolicyAttempt(msgspec.Struct):
    """One privileged policy for a concept.

    Attributes:
        number: 0 for the first policy; each rewrite adds one.
        source: Text of the file.
        wins: Episodes that it won.
        episodes: Episodes that it played.
        fault: What is wrong with it, or "".
        provenance: The requests that it comes from.
    """

    number: int
    source: str
    wins: int = 0
    episodes: int = 0
    fault: str = ""
    provenance: dict[str, Any] = {}


@dataclass
class ConceptState:
    """Everything known about one concept.

    Attributes:
        concept: Id of the concept.
        title: Title of the game.
        idea: Text of the concept.
        data: The concept as plain data.
        brief: The design document, or "".
        attempts: The sources so far, in order.
        policies: The privileged policies so far, in order.
        outcomes: Outcomes by stage.
    """

    concept: str
    title: str
    idea: str
    data: dict[str, Any] = field(default_factory=dict)
    brief: str = ""
    attempts: list[Attempt] = field(default_factory=list)
    policies: list[PolicyAttempt] = field(default_factory=list)
    outcomes: dict[str, StageOutcome] = field(default_factory=dict)

    @property
    def best(self) -> Attempt | None:
        """The last attempt that is not degenerate."""
        return next((attempt for attempt in reversed(self.attempts) if not attempt.degenerate), None)


class PolicyEvaluation(msgspec.Struct, frozen=True):
    """The report of the check ``difficulty`` on a privileged policy, and how many of its episodes the policy won."""

    report: SubjectReport
    wins: int
    episodes: int


class StageContext(ABC):
    """The services that a stage uses. What a method stores is on disk when the method returns.

    The pipeline handles the exceptions of these methods: a stage lets them propagate.
    """

    @abstractmethod
    async def generate(self, state: ConceptState, request: StageRequest) -> StageReply:
        """Return a model's completion."""

    @abstractmethod
    async def judge(self, state: ConceptState, attempt: Attempt) -> None:
        """Run all checks on an attempt, and set its `report` and `profile`."""

    @abstractmethod
    async def play(self, state: ConceptState, attempt: Attempt, policy: str) -> PolicyEvaluation:
        """Run the source of a privileged policy on an attempt's environment."""

    @abstractmethod
    def keep_brief(self, state: ConceptState, text: str, provenance: dict[str, Any]) -> None:
        """Store the concept's brief."""

    @abstractmethod
    def keep_attempt(self, state: ConceptState, attempt: Attempt) -> None:
        """Store an attempt; it replaces an attempt of the same number."""

    @abstractmethod
    def drop_attempts(self, state: ConceptState, number: int) -> None:
        """Delete the attempts from this number on."""

    @abstractmethod
    def keep_policy(self, state: ConceptState, policy: PolicyAttempt) -> None:
        """Store a privileged policy; it replaces a policy of the same number."""

    @abstractmethod
    def publish(self, state: ConceptState, attempt: Attempt) -> str:
        """Add an attempt to the corpus as an environment, and return its name."""


class Stage(ABC):
    """One step from a concept to an environment.

    Attributes:
        name: Name for ``--from`` and ``--until``, in lower case.
        summary: One line for people.
        after: The stage before this one; "" for the first.
        replaces: The stage whose place this one takes; "" for an additional stage.
        optional: Whether it runs only if ``--with`` names it.
    """

    name: str
    summary: str
    after: str = ""
    replaces: str = ""
    optional: bool = False

    @abstractmethod
    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        """Run the stage on one concept.

        The run may be interrupted anywhere. A later run then starts the stage again, with everything that was stored.
        """
