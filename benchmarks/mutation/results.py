"""The result of each mutant, kept in a file of JSON lines so that an interrupted run continues."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

import msgspec

from benchmarks.mutation.operator import OPERATORS


class Result(msgspec.Struct, frozen=True):
    """What a run found on one mutant, or on a game that was not changed.

    Attributes:
        operator: its name, "" for a game that was not changed.
        game: the name of the game.
        number: which of the operator's places in the game.
        sha256: of the text.
        budget: of the validation.
        seed: of the validation.
        code: the digest of EnvCraft's own code.
        errors: the codes of findings that fail the environment.
        warnings: the codes of other findings.
        verdict: of the validation.
        steps: environment steps.
        seconds: of the validation.
        equivalent: long replay shows no difference from the game; None where it was not needed.
        peers: what each peer complains about.
    """

    operator: str
    game: str
    number: int
    sha256: str
    budget: str
    seed: int
    code: str
    errors: list[str]
    warnings: list[str]
    verdict: str
    steps: int
    seconds: float
    equivalent: bool | None = None
    peers: dict[str, str] = {}

    @property
    def key(self) -> Key:
        """The key of :func:`key`."""
        return self.operator, self.sha256, self.budget, self.seed, self.code

    @property
    def loads(self) -> bool:
        """Whether the file can be imported and its class constructed."""
        return not any(code.startswith("EC00") and code != "EC009" for code in self.errors)

    @property
    def counts(self) -> bool:
        """Whether the mutant is a defect that could be judged."""
        return self.loads and self.verdict != "error" and not self.equivalent

    @property
    def caught(self) -> bool:
        """Whether an error names the defect, or a warning where the rules only warn of such a defect."""
        operator = OPERATORS[self.operator]
        return any(map(operator.names, [*self.errors, *(self.warnings if operator.warns else ())]))

    @property
    def warned(self) -> bool:
        """Whether only a warning names the defect, where an error should."""
        return not self.caught and any(map(OPERATORS[self.operator].names, self.warnings))


#: What a result depends on: the operator, and the digest of the text, budget, seed and code as in `Result`.
Key = tuple[str, str, str, int, str]


def key(operator: str, text: str, budget: str, seed: int, code: str) -> Key:
    """What the result of a mutant depends on."""
    return operator, hashlib.sha256(text.encode()).hexdigest(), budget, seed, code


def read(path: Path | None) -> dict[Key, Result]:
    """The results that a file has, by their keys. A line that was cut off by an interruption is left out."""
    found = {}
    for line in path.read_bytes().splitlines() if path is not None and path.exists() else []:
        try:
            result = msgspec.json.decode(line, type=Result)
        except msgspec.DecodeError:
            continue
        found[result.key] = result
    return found


def append(path: Path | None, result: Result) -> None:
    if path is not None:
        with path.open("ab") as file:
            file.write(msgspec.json.encode(result) + b"\n")


def of_operator(results: Iterable[Result], name: str) -> list[Result]:
    return [result for result in results if result.operator == name]
