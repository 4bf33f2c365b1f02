"""Judge each subject once per session, and share the reports among xdist's workers."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import pytest

from envcraft.cli.commands.validate import blame_settings, read_kwargs, read_wrappers, severity_of
from envcraft.cli.commands.validate import validate as validate_command
from envcraft.cli.configured import of_the_file, place, renamed
from envcraft.cli.options import policy_of
from envcraft.contracts.lookup import contract_named
from envcraft.environments.targets import resolve
from envcraft.errors import EnvCraftError, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.selection import driver_named, select_checks, split
from envcraft.judging.severity import SeverityPolicy
from envcraft.model.project import configured
from envcraft.model.target import kind_of
from envcraft.model.verdict import CheckReport, SubjectReport, Verdict, overall, plain
from envcraft.pytest_plugin.settings import SETTINGS
from envcraft.registry import did_you_mean, offered
from envcraft.text import relative

if TYPE_CHECKING:
    from envcraft.judging.check import Check
    from envcraft.judging.driver import Driver
    from envcraft.model.target import Target

_MAX_SEED = 2**31 - 1
#: How a message about checks refers to codes.
_CODES = re.compile(r"--(select|ignore) (\w+)")


class Settings(NamedTuple):
    """How to judge. Lists are names separated by commas, as on the command line; None means that nothing is said."""

    contract: str = "arcade"
    budget: str = "standard"
    sandbox: str = "auto"
    seed: int = 0
    checks: str | None = None
    skip: str | None = None
    runtime: str | None = None
    require_isolation: str | None = None
    time_limit: float | None = None
    select: str | None = None
    ignore: str | None = None
    exclude: tuple[str, ...] = ()
    baseline: str | None = None
    strict: bool = False
    fail_fast: bool = False
    policy: str | None = None
    kwargs: str | None = None
    wrap: tuple[str, ...] = ()

    def for_one(self) -> Settings:
        """Return the same settings without a selection of checks."""
        return self._replace(checks=None, skip=None)

    def selected(self, severity: SeverityPolicy) -> list[Check]:
        """The checks that run. Raises UsageError if a name does not exist."""
        return select_checks(self.checks, self.skip, severity.select, severity.ignore)

    def severity(self, folder: Path) -> SeverityPolicy:
        """Which findings count in the project of a folder. Raises UsageError."""
        return severity_of(folder, self.strict, self.select, self.ignore, self.baseline)


class Spec(NamedTuple):
    """What to judge: an absolute path or another TARGET of ``envcraft validate``, and the class in it."""

    target: str
    env_class: str | None = None


class Case(NamedTuple):
    """One check of one subject."""

    spec: Spec
    settings: Settings
    check: str


class Judged(NamedTuple):
    """A subject's report with its target and settings."""

    spec: Spec
    settings: Settings
    report: SubjectReport


class Outcome(NamedTuple):
    """The result of a case.

    `riders` are reports of checks that nobody selected and that do not pass; they run because every verdict depends on
    them.
    """

    judged: Judged
    own: CheckReport
    riders: list[CheckReport]

    @property
    def reports(self) -> list[CheckReport]:
        return [*self.riders, self.own]

    @property
    def verdict(self) -> Verdict:
        verdict = overall(self.reports)
        return self.own.verdict if verdict is Verdict.PASS else verdict


class Judge:
    """Judge subjects for one session of pytest, each once with all checks that its tests need."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._reports: dict[str, SubjectReport | EnvCraftError] = {}
        self._drivers: dict[tuple[str, str | None, str | None], Driver | EnvCraftError] = {}
        self._wanted: dict[tuple[Spec, Settings], set[str]] | None = None
        worker: dict[str, Any] = getattr(config, "workerinput", {})
        self._lanes_of = int(worker.get("workercount", 1))
        self._shared = _usable(worker.get("envcraft_shared"))

    def case(self, session: pytest.Session, case: Case) -> Outcome:
        """Return one check's outcome. Raises EnvCraftError if nothing could be judged."""
        if self._wanted is None:
            self._wanted = {}
            for found in filter(None, map(case_of, session.items)):
                self._wanted.setdefault((found.spec, found.settings), set()).add(found.check)
        wanted = self._wanted.get((case.spec, case.settings), set()) | {case.check}
        judged = self.subject(case.spec, case.settings._replace(checks=",".join(sorted(wanted))))
        reports = judged.report.checks
        own = next(report for report in reports if report.check == case.check)
        return Outcome(judged, own, riders(reports, wanted, case.check))

    def subject(self, spec: Spec, settings: Settings) -> Judged:
        """Judge a whole subject. Raises EnvCraftError if nothing could be judged."""
        target = self.target(spec)
        severity = settings.severity(self._config.rootpath)
        names = [check.name for check in settings.selected(severity)]
        asked = (target, settings.for_one(), names)
        key = hashlib.sha256(msgspec.json.encode(asked)).hexdigest()
        if key not in self._reports:
            try:
                self._reports[key] = self._share(key, lambda: self._judge(target, settings, severity))
            except EnvCraftError as error:
                self._reports[key] = error
        found = self._reports[key]
        if isinstance(found, EnvCraftError):
            raise found
        return Judged(spec, settings, found)

    def require_sandbox(self, settings: Settings) -> None:
        """Raise EnvCraftError if the sandbox does not work."""
        self._driver(settings)

    def close(self) -> None:
        """Close the sandbox drivers."""
        for driver in self._drivers.values():
            if not isinstance(driver, EnvCraftError):
                driver.close()

    def target(self, spec: Spec) -> Target:
        """Read what a spec names. Raises UsageError if that is not one environment."""
        targets = resolve(spec.target, spec.env_class)
        if len(targets) != 1:
            raise UsageError(
                f"{spec.target} holds {len(targets)} environments, and a test judges one: name its file, or collect "
                "the folder with `pytest --envcraft`"
            )
        [target] = targets
        if os.path.isabs(target.path):
            # As a person would type it in the folder where pytest started.
            return msgspec.structs.replace(target, path=relative(target.path, str(self._config.invocation_params.dir)))
        return target

    def _judge(self, target: Target, settings: Settings, severity: SeverityPolicy) -> SubjectReport:
        from envcraft.judging.engine import Plan, cores, validate
        from envcraft.model.events import Finished

        plan = Plan(
            [configured(target, read_kwargs(settings.kwargs), settings.wrap)],
            contract_named(settings.contract),
            self._driver(settings),
            settings.selected(severity),
            BUDGETS[settings.budget],
            settings.seed,
            policy_of(settings.policy),
            parallel_jobs=max(cores() // self._lanes_of, 1),
            time_limit=settings.time_limit,
            fail_fast=settings.fail_fast,
            severity=severity,
        )
        with warnings.catch_warnings():
            # pytest's filters are for the tests' own code and must not change a verdict.
            warnings.simplefilter("ignore")
            with contextlib.closing(validate(plan, 1)) as events:
                [report] = [event.report for event in events if isinstance(event, Finished)]
        [subject] = report.reports
        for _ in blame_settings(subject, lambda error: of_the_file(error, self._config.rootpath)):
            pass
        return subject

    def _driver(self, settings: Settings) -> Driver:
        key = settings.sandbox, settings.require_isolation, settings.runtime
        if key not in self._drivers:
            try:
                self._drivers[key] = driver_named(*key)
            except EnvCraftError as error:
                # Another attempt would take as long and fail again.
                configured = error.setting == "require-isolation"
                self._drivers[key] = of_the_file(error, self._config.rootpath) if configured else error
        found = self._drivers[key]
        if isinstance(found, EnvCraftError):
            raise found
        return found

    def _share(self, key: str, judge: Callable[[], SubjectReport]) -> SubjectReport:
        """Judge, or take the report of another xdist worker, waiting for it if needed."""
        if self._shared is None:
            return judge()
        import fcntl

        file = self._shared / f"{key}.json"
        with (self._shared / f"{key}.lock").open("w") as lock:
            # The system releases the lock if this process dies.
            fcntl.flock(lock, fcntl.LOCK_EX)
            if file.exists():
                return msgspec.json.decode(file.read_bytes(), type=SubjectReport)
            report = judge()
            written = file.with_suffix(".part")
            written.write_bytes(msgspec.json.encode(plain(report)))
            written.replace(file)
            return report


_JUDGE = pytest.StashKey[Judge]()
CASE = pytest.StashKey[Case]()


def judge_of(config: pytest.Config) -> Judge:
    """Return the judge of this session."""
    if _JUDGE not in config.stash:
        config.stash[_JUDGE] = Judge(config)
    return config.stash[_JUDGE]


def close(config: pytest.Config) -> None:
    """Close the session's judge, if there is one."""
    if judge := config.stash.get(_JUDGE, None):
        judge.close()


def case_of(item: pytest.Item) -> Case | None:
    """Return the check that a test stands for, or None."""
    callspec = getattr(item, "callspec", None)
    found = item.stash.get(CASE, None) or (callspec and callspec.params.get("envcraft"))
    return found if isinstance(found, Case) else None


def riders(reports: Iterable[CheckReport], wanted: set[str], check: str) -> list[CheckReport]:
    """Return the reports that the test of `check` shows besides its own.

    A check that is not selected and does not pass is shown by the next selected check, or by the last one.
    """
    reports = list(reports)
    order = [report.check for report in reports if report.check in wanted]
    carried = []
    for number, report in enumerate(reports):
        if report.check not in wanted and report.verdict in (Verdict.FAIL, Verdict.ERROR):
            later = [other.check for other in reports[number:] if other.check in wanted]
            if check == (later[0] if later else order[-1]):
                carried.append(report)
    return carried


def spec_of(target: object, root: Path) -> Spec:
    """Resolve a class, a path relative to `root`, or a name. Raises UsageError."""
    if inspect.isclass(target):
        return _class_spec(target)
    if not isinstance(target, str | os.PathLike) or not os.fspath(target):
        raise UsageError(
            f"{target!r} is not a target: pass an environment class, a path, or another TARGET of envcraft validate"
        )
    path = os.path.join(root, target)
    if os.path.exists(path):
        return Spec(path)
    if kind_of(os.fspath(target)) is None and not os.path.exists(target):
        near = os.path.relpath(f"{path}.py", root) if os.path.isfile(f"{path}.py") else ""
        words = (
            f"did you mean {near}?" if near else "name a Python file, package.module:Class or an id like CartPole-v1"
        )
        raise UsageError(f"{target} does not exist in {root}, pytest's root folder; {words}")
    return Spec(os.fspath(target))


def _class_spec(target: type) -> Spec:
    name = f"{target.__module__}.{target.__qualname__}"
    module = sys.modules.get(target.__module__)
    file = getattr(module, "__file__", None)
    if file is None or not os.path.isfile(file):
        raise UsageError(f"{name} is not defined in a file; save it in one")
    if target.__qualname__ != target.__name__:
        raise UsageError(f"{name} is defined inside a function or class; move it to the top level of its file")
    return Spec(os.path.abspath(file), target.__name__)


def settings(config: pytest.Config, given: dict[str, Any] | None = None) -> Settings:
    """Resolve the settings; `given` ones win. Raises UsageError if a value does not exist."""
    folder = config.rootpath
    read = validate_command.read(folder)
    found = {name: value for name, value in read.items() if name in Settings._fields}
    # Where values that are not from the project's file are from; a call or a marker names itself.
    origins: dict[str, str] = {}
    for name in SETTINGS:
        option = name.replace("_", "-")
        # In pytest's configuration an empty value is none.
        for value, origin in (
            ((given or {}).get(name), ""),
            (config.getoption(f"envcraft_{name}"), f"--envcraft-{option}"),
            (config.getini(f"envcraft_{name}") or None, _place_of_ini(config, f"envcraft_{name}")),
        ):
            if value is not None:
                found[name], origins[option] = value, origin
                break
    try:
        chosen = Settings(**{name: _plain(name, value) if name in SETTINGS else value for name, value in found.items()})
        _require(chosen, folder)
    except UsageError as error:
        setting = error.setting
        names = {name: name for name in ("checks", "skip", "select", "ignore")}
        if setting in origins:
            wrong = UsageError(_from(origins[setting], setting, str(error)))
            names = {name: place(name, folder) for name in names}
        else:
            wrong = of_the_file(error, folder) if setting.replace("-", "_") in found else error
        raise renamed(wrong, names | {name: origin or name for name, origin in origins.items()}) from None
    return chosen


def _place_of_ini(config: pytest.Config, name: str) -> str:
    """Where a value of pytest's configuration is, for messages."""
    overridden = any(words.partition("=")[0] == name for words in config.getoption("override_ini") or ())
    return f"-o {name}" if overridden else f"{config.inipath}: {name}"


def _from(origin: str, setting: str, words: str) -> str:
    """An error about a setting that names the option or the key that its value is from."""
    option, key = f"--{setting}", origin.rpartition(" ")[2] or setting
    # pytest has no option for codes.
    words = _CODES.sub(r'\1 = "\2" in [tool.envcraft]', words)
    if not origin or words.startswith(option):
        return words.replace(option, origin or key)
    return f"{origin}: {words.replace(option, key)}"


def _require(chosen: Settings, folder: Path) -> None:
    """Raise UsageError if a name does not exist."""
    contract_named(chosen.contract)
    chosen.selected(chosen.severity(folder))
    policy_of(chosen.policy)
    read_kwargs(chosen.kwargs)
    read_wrappers(chosen.wrap)
    if chosen.budget not in BUDGETS:
        raise UsageError(f"there is no budget {did_you_mean(chosen.budget, BUDGETS)}", setting="budget")
    if chosen.sandbox != "auto":
        # Loading the drivers takes longer than collecting a folder.
        drivers = ["auto", *(driver.name for driver in offered("envcraft_sandbox_drivers"))]
        if chosen.sandbox not in drivers:
            raise UsageError(f"there is no sandbox {did_you_mean(chosen.sandbox, drivers)}", setting="sandbox")


def _plain(name: str, value: Any) -> Any:
    """Convert a setting to its type."""
    if name == "seed":
        if not str(value).isdecimal() or int(value) > _MAX_SEED:
            words = f"the seed {value!r} is not a whole number from 0 to {_MAX_SEED}"
            raise UsageError(words, setting="seed")
        return int(value)
    if name == "time_limit":
        try:
            seconds = math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError):
            seconds = math.nan
        if not 0 < seconds < math.inf:
            words = f"the time limit {value!r} is not a number of seconds above 0"
            raise UsageError(words, setting="time-limit")
        return seconds
    names = [value] if isinstance(value, str) else value
    if name in ("checks", "skip"):
        listed = ",".join(split(",".join(map(str, names))))
        # No check to skip is a choice; no check to run is none.
        return listed if name == "checks" else listed or None
    if not isinstance(value, str):
        raise UsageError(f"{name} must be a name, not {value!r}", setting=name)
    return value


def _usable(folder: str | None) -> Path | None:
    """Return the folder that xdist's workers share, or None on another machine."""
    if folder is None:
        return None
    with contextlib.suppress(OSError):
        if os.stat(folder).st_uid == os.getuid():
            return Path(folder)
    return None
