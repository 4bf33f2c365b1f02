"""The verdicts of ``envcraft validate`` on single files, in the user's cache folder, for ``envcraft.make``.

Only a verdict that an audit could have given is kept: of all checks, without an author's severities, baseline or
comments that ignore findings. Each verdict is one small JSON file. What cannot be written or read counts as absent.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import EnvCraftError
from envcraft.files import atomic_write
from envcraft.judging.settings import Settings, rules_version, settings_of
from envcraft.model.target import Kind, Target
from envcraft.model.verdict import Report, SubjectReport, Verdict
from envcraft.registry import offered

if TYPE_CHECKING:
    from envcraft.judging.engine import Plan

#: The environment variable that names the cache folder. An empty value switches the cache off.
VARIABLE = "ENVCRAFT_CACHE"
_MAX_BYTES = 64 * 1024


class CachedVerdict(msgspec.Struct, frozen=True):
    """A verdict on a source file.

    Attributes:
        settings: What the verdict depends on besides the source.
        source_sha256: The SHA-256 of the source.
        env_class: The class that was judged.
        verdict: ``pass`` or ``fail``.
        project: The SHA-256 of each file of its project that it was judged with, by path.
    """

    settings: Settings
    source_sha256: str
    env_class: str | None
    verdict: Verdict
    project: dict[str, str] = {}


def record(plan: Plan, report: Report) -> None:
    """Keep the verdicts of a run that an audit could have given.

    Args:
        plan: The run's settings, with its targets in memory.
        report: The result.
    """
    severity = plan.severity
    apart = severity.table or severity.strict or severity.select or severity.ignore or severity.baseline
    if apart or plan.fail_fast or plan.policy or (folder := _folder()) is None:
        return
    pairs = [pair for pair in zip(plan.targets, report.reports, strict=False) if _counts(*pair)]
    if not pairs:
        return
    with contextlib.suppress(OSError, EnvCraftError):
        settings = settings_of(plan.contract, plan.checks, plan.driver, plan.budget, plan.seed)
        if settings.checks:
            return
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for target, judged in pairs:
            files = judged.project.files if judged.project is not None else {}
            kept = CachedVerdict(settings, target.sha256, judged.env_class, judged.verdict, files)
            with atomic_write(folder / f"{target.sha256}-{settings.digest}.json") as stream:
                stream.write(msgspec.json.encode(kept))


def cached(source_sha256: str) -> list[CachedVerdict]:
    """Find the verdicts on a source that the present checks and code have given, the newest first.

    Args:
        source_sha256: The SHA-256 of the source.
    """
    found = _kept(source_sha256)
    if not found:
        return []
    checks = [check for check in offered("envcraft_checks") if not check.opt_in]
    drivers = {driver.name: driver for driver in offered("envcraft_sandbox_drivers")}
    rules = {
        name: rules_version(checks, drivers[name])
        for name in {kept.settings.driver for kept in found}
        if name in drivers
    }
    current = [kept for kept in found if rules.get(kept.settings.driver) == kept.settings.rules]
    return [kept for kept in current if not kept.settings.checks]


def last_contract(source_sha256: str) -> str | None:
    """The contract of the newest verdict on a source, also of one that earlier code has given; None without one.

    Args:
        source_sha256: The SHA-256 of the source.
    """
    return next((kept.settings.contract for kept in _kept(source_sha256)), None)


def _kept(source_sha256: str) -> list[CachedVerdict]:
    """The verdicts on a source, the newest first."""
    found: list[tuple[int, CachedVerdict]] = []
    with contextlib.suppress(OSError):
        folder = _folder()
        for file in folder.glob(f"{source_sha256}-*.json") if folder else ():
            with contextlib.suppress(OSError, msgspec.DecodeError), open(file, "rb") as stream:
                kept = msgspec.json.decode(stream.read(_MAX_BYTES), type=CachedVerdict)
                # A file that was renamed is no verdict on this source.
                if file.name == f"{source_sha256}-{kept.settings.digest}.json" and kept.source_sha256 == source_sha256:
                    found.append((os.fstat(stream.fileno()).st_mtime_ns, kept))
    found.sort(key=lambda pair: pair[0], reverse=True)
    return [kept for _, kept in found]


def _counts(target: Target, report: SubjectReport) -> bool:
    """Whether a verdict is on a file as it is, with its only class, and final."""
    plain = target.kind is Kind.SOURCE and not (target.env_class or target.kwargs or target.wrappers)
    # `envcraft.make` imports one file.
    alone = report.project is None or target.project is None or not target.project.modules
    final = report.verdict in (Verdict.PASS, Verdict.FAIL) and not report.out_of_time
    waived = any(check.ignored or check.known for check in report.checks)
    return plain and alone and final and not waived and report.source_sha256 == target.sha256


def _folder() -> Path | None:
    """The folder of the verdicts; None if the cache is off, or there is no home folder."""
    named = os.environ.get(VARIABLE)
    if named == "":
        return None
    if named is not None:
        return Path(named, "verdicts")
    home = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # The XDG Base Directory Specification ignores relative paths.
        return Path(home if os.path.isabs(home) else Path.home() / ".cache", "envcraft", "verdicts")
    except RuntimeError:
        return None
