"""The results of judging: findings, the verdict of each check, the report of each subject, and all as JSON.

The field names are the public JSON of ``envcraft validate --format json``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any

import msgspec

from envcraft.model.target import Kind
from envcraft.version import __version__

SCHEMA = 1


class Verdict(StrEnum):
    """The outcome of a check, or of a subject."""

    PASS = "pass"
    FAIL = "fail"
    SKIP = "skip"
    ERROR = "error"


class Outcome(StrEnum):
    """How a summary counts a check or a subject: as its verdict, except that what stays open is undecided.

    A check is undecided if it applies and could not settle its question. A subject is undecided if it passes and one of
    its checks is undecided.
    """

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    SKIP = "skip"
    ERROR = "error"


class Severity(StrEnum):
    """Whether a finding fails its check (``error``) or not (``warning``)."""

    ERROR = "error"
    WARNING = "warning"


class Repro(msgspec.Struct, frozen=True):
    """A minimal reproduction: ``envcraft replay`` runs it again.

    ``step`` receives `actions` after ``reset(seed=seed)``. `conditions` are fields of
    :class:`envcraft.model.rollout.Conditions`.
    """

    seed: int = 0
    actions: list[Any] = []
    conditions: dict[str, Any] = {}


class Line(msgspec.Struct, frozen=True):
    """Where a method of the environment is: a line of the target's file.

    Attributes:
        number: of the method, or of the class if another file defines the method, or of the import of the class if
            another file defines that, too; None if none is known.
        note: which class of another file has the method, in words; "" if none has.
    """

    number: int | None
    note: str = ""


class Finding(msgspec.Struct, frozen=True):
    """One violation of one rule."""

    code: str
    severity: Severity
    message: str
    line: int | None = None
    evidence: dict[str, Any] = {}
    repro: Repro = Repro()

    def as_warning(self) -> Finding:
        """The same finding with the severity warning."""
        return msgspec.structs.replace(self, severity=Severity.WARNING)


class Ignored(msgspec.Struct, frozen=True):
    """A finding that a comment of the author ignores, with the reason that the comment gives and its line."""

    finding: Finding
    reason: str
    line: int


class CheckReport(msgspec.Struct):
    """One check's verdict on one subject.

    `reason` says why a check was skipped or ended in an error. With `undecided` the check applies, but its question
    is still open. `ignored` findings, and those that are `known` from a baseline, count nowhere. `wrong_use` marks a
    usage error: the target or an option names something that does not exist.
    """

    check: str
    verdict: Verdict
    seconds: float = 0.0
    findings: list[Finding] = []
    reason: str = ""
    undecided: bool = False
    ignored: list[Ignored] = []
    known: list[Finding] = []
    wrong_use: bool = False

    @property
    def outcome(self) -> Outcome:
        """How summaries count this check."""
        if self.undecided and self.verdict is Verdict.SKIP:
            return Outcome.UNDECIDED
        return Outcome(self.verdict.value)


class SandboxReport(msgspec.Struct, frozen=True):
    """What the code ran in: the driver, its protections in force, those that this machine lacks, and the digest of the
    container's image.
    """

    driver: str = ""
    layers: list[str] = []
    missing: list[str] = []
    image: str | None = None

    @classmethod
    def of(cls, driver: str, layers: Iterable[str], missing: Iterable[str], about: Mapping[str, Any]) -> SandboxReport:
        """Combine what a driver says about this machine with what its worker reports from inside.

        Args:
            driver: the driver's name.
            layers: the protections that the driver puts in force.
            missing: the protections that the driver lacks here.
            about: what a worker reports (:attr:`envcraft.judging.driver.Worker.about`).
        """
        layers = dict.fromkeys([*layers, *map(str, about.get("layers", ()))])
        missing = dict.fromkeys([*missing, *map(str, about.get("missing", ()))])
        image = about.get("image")
        # What holds on either side of the boundary is not missing.
        missing = {layer: None for layer in missing if layer not in layers}
        return cls(driver, list(layers), list(missing), None if image is None else str(image))


class ProjectFiles(msgspec.Struct):
    """What was judged with a file of a project: the project's folder, the SHA-256 of each file by path below it, and
    the folders below it that imports start from, if there are several.
    """

    root: str
    files: dict[str, str]
    imports: list[str] = []


class SubjectReport(msgspec.Struct):
    """All checks' verdicts on one subject; `steps` are environment steps, `seconds` wall time.

    `path`, `kind`, `kwargs` and `wrappers` are those of the target. `module` is the module of an installed class and
    `source_file` its file: `source_sha256` and the lines of findings refer to it. In a notebook, lines count within the
    cell that the evidence `cell` names. `traces` is a digest of all episodes, empty if none was played. `fingerprint`
    identifies the behaviour (:func:`envcraft.similarity.behavioural.fingerprint`), empty if it is not known. `project`
    has the files that the environment imports or reads besides its own. With `out_of_time` the time limit was over
    before every question was settled, and with `fail_fast` the validation ended at the first error.
    """

    path: str
    env_class: str | None
    source_sha256: str
    verdict: Verdict
    isolation: str
    seconds: float
    steps: int
    checks: list[CheckReport]
    driver: str = ""
    reason: str = ""
    policy: str | None = None
    sandbox: SandboxReport = SandboxReport()
    kind: Kind = Kind.SOURCE
    module: str | None = None
    source_file: str | None = None
    kwargs: dict[str, Any] = {}
    wrappers: list[str] = []
    project: ProjectFiles | None = None
    traces: str = ""
    fingerprint: str = ""
    out_of_time: bool = False
    fail_fast: bool = False

    @property
    def outcome(self) -> Outcome:
        """How summaries count this subject."""
        if self.verdict is Verdict.PASS and self.undecided:
            return Outcome.UNDECIDED
        return Outcome(self.verdict.value)

    @property
    def undecided(self) -> list[str]:
        """The names of the checks that left their questions open."""
        return [check.check for check in self.checks if check.outcome is Outcome.UNDECIDED]

    @property
    def file(self) -> str:
        """The file or module that the lines of findings refer to."""
        return self.source_file or self.module or self.path


class Report(msgspec.Struct):
    """The result of one run of ``envcraft validate``.

    `severity` is the table of severities that the run applied, and with `strict` its warnings are errors. `unjudged`
    counts the environments that were not judged because an earlier one failed.
    """

    contract: str
    seed: int
    reports: list[SubjectReport]
    schema: int = SCHEMA
    envcraft: str = __version__
    budget: str = "standard"
    severity: dict[str, str] = {}
    strict: bool = False
    unjudged: int = 0

    def to_json(self) -> bytes:
        """Encode as indented JSON. NaN and infinities, which JSON lacks, are written as strings."""
        return msgspec.json.format(msgspec.json.encode(plain(self)), indent=2)


def overall(checks: list[CheckReport]) -> Verdict:
    """A subject's verdict: fail if any check fails, else error if any check ends in an error, else pass."""
    verdicts = {check.verdict for check in checks}
    for verdict in (Verdict.FAIL, Verdict.ERROR):
        if verdict in verdicts:
            return verdict
    return Verdict.PASS


def plain(value: Any) -> Any:
    """Convert to JSON types only; non-finite numbers become strings."""
    if isinstance(value, msgspec.Struct):
        fields = msgspec.structs.asdict(value)
        order = sorted(fields, key=lambda name: _ORDER.index(name) if name in _ORDER else len(_ORDER))
        return {name: plain(fields[name]) for name in order}
    if isinstance(value, dict):
        return {plain(str(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, StrEnum):
        return value.value
    if isinstance(value, str):
        # Lone surrogates, as in a file name that is not UTF-8, have no encoding.
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, int) and not isinstance(value, bool) and not -(2**63) <= value < 2**64:
        return str(value)
    if value is None or isinstance(value, int | float):
        return value
    if hasattr(value, "item"):
        return plain(value.item())
    return str(value)


_ORDER = (
    "schema",
    "envcraft",
    "contract",
    "seed",
    "budget",
    "path",
    "env_class",
    "source_sha256",
    "check",
    "verdict",
    "isolation",
)
