"""What judging gives: findings, the verdict of each check, the report of each subject, and the whole as JSON.

The field names are the public JSON of ``envcraft validate --format json``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft import __version__
from envcraft.target import Kind

if TYPE_CHECKING:
    from envcraft.sandbox import Driver

SCHEMA = 1


class Verdict(StrEnum):
    """The outcome of a check, or of a subject."""

    PASS = "pass"
    FAIL = "fail"
    SKIP = "skip"
    ERROR = "error"


class Severity(StrEnum):
    """Whether a finding fails its check (``error``) or only tells (``warning``)."""

    ERROR = "error"
    WARNING = "warning"


class Repro(msgspec.Struct, frozen=True):
    """A minimal reproduction: ``envcraft replay`` runs it again.

    `actions` are what ``step`` receives after ``reset(seed=seed)``, and `conditions` what differs from an ordinary
    process (the fields of :class:`envcraft.rollout.Conditions`).
    """

    seed: int = 0
    actions: list[Any] = []
    conditions: dict[str, Any] = {}


class Finding(msgspec.Struct, frozen=True):
    """One violation of one rule."""

    code: str
    severity: Severity
    message: str
    line: int | None = None
    evidence: dict[str, Any] = {}
    repro: Repro = Repro()


class CheckReport(msgspec.Struct):
    """One check's verdict on one subject. `reason` says why a check was skipped or could not judge."""

    check: str
    verdict: Verdict
    seconds: float = 0.0
    findings: list[Finding] = []
    reason: str = ""


class SandboxReport(msgspec.Struct, frozen=True):
    """What the code ran in: the driver, its protections in force, those that this machine lacks, and the digest of the
    container's image.
    """

    driver: str = ""
    layers: list[str] = []
    missing: list[str] = []
    image: str | None = None

    @classmethod
    def of(cls, driver: Driver, about: Mapping[str, Any]) -> SandboxReport:
        """What `driver` says of itself, and a worker of its (:attr:`envcraft.sandbox.Worker.about`) found inside."""
        available = driver.probe()
        layers = dict.fromkeys([*available.layers, *map(str, about.get("layers", ()))])
        missing = dict.fromkeys([*available.missing, *map(str, about.get("missing", ()))])
        image = about.get("image")
        # What holds on either side of the boundary is not missing.
        missing = {layer: None for layer in missing if layer not in layers}
        return cls(driver.name, list(layers), list(missing), None if image is None else str(image))


class SubjectReport(msgspec.Struct):
    """All checks' verdicts on one subject; `steps` are environment steps, `seconds` wall time.

    `path`, `kind`, `kwargs` and `wrappers` are those of the target. `module` is that of an installed class: lines of
    findings are lines of its file, which `source_sha256` is of. `fingerprint` tells environments apart that behave
    otherwise (:func:`envcraft.similarity.behavioural.fingerprint`), "" where it is not known.
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
    kwargs: dict[str, Any] = {}
    wrappers: list[str] = []
    fingerprint: str = ""

    @property
    def file(self) -> str:
        """What the lines of findings are counted in."""
        return self.module or self.path


class Report(msgspec.Struct):
    """Everything one run of ``envcraft validate`` found."""

    contract: str
    seed: int
    reports: list[SubjectReport]
    schema: int = SCHEMA
    envcraft: str = __version__
    budget: str = "standard"

    def to_json(self) -> bytes:
        """Encode as indented JSON. NaN and infinities, which JSON lacks, are written as strings."""
        return msgspec.json.format(msgspec.json.encode(plain(self)), indent=2)


def overall(checks: list[CheckReport]) -> Verdict:
    """A subject's verdict: fail if any check fails, else error if any could not judge, else pass."""
    verdicts = {check.verdict for check in checks}
    for verdict in (Verdict.FAIL, Verdict.ERROR):
        if verdict in verdicts:
            return verdict
    return Verdict.PASS


def plain(value: Any) -> Any:
    """Give `value` as JSON types only, non-finite numbers as their names."""
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
        # Lone surrogates (a file name that is no UTF-8, say) have no encoding.
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
