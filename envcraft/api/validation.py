"""``envcraft.validate`` and ``envcraft.check_env``."""

from __future__ import annotations

import contextlib
import inspect
import json
import math
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import msgspec

from envcraft.api.extraction import target_of
from envcraft.api.report import ShownReport
from envcraft.contracts.lookup import contract_named
from envcraft.demonstrations.player import policy_named
from envcraft.environments.targets import resolve
from envcraft.errors import EnvCraftError, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan
from envcraft.judging.engine import validate as judge
from envcraft.judging.installed import is_installed
from envcraft.judging.selection import driver_named, rules_of, select_checks
from envcraft.judging.severity import OFF, SeverityPolicy, severity_table
from envcraft.judging.verdict_cache import record
from envcraft.model.events import Finished
from envcraft.model.project import configured, with_project
from envcraft.model.target import Kind, Target, kind_of
from envcraft.model.verdict import Finding, Severity, Verdict
from envcraft.registry import lookup
from envcraft.reports.evidence import keep_source

#: Wrappers that ``gymnasium.make`` adds, which say nothing about the environment.
_USUAL = ("OrderEnforcing", "PassiveEnvChecker", "TimeLimit")
#: The codes that the parameters of Gymnasium's check_env leave out.
_RENDERING, _CLOSING = ("EC112", "EC116", "EC117"), ("EC113",)

#: The highest seed, as of ``--seed``.
_MAX_SEED = 2**31 - 1
#: What an instance has that does not keep a parameter.
_UNKNOWN = object()
#: The types of values that compare as they look.
_PLAIN = (bool, int, float, str, type(None))


class CheckFailed(EnvCraftError, AssertionError):
    """An environment has defects. As other checkers raise AssertionError, this is one.

    Attributes:
        report: the whole report.
    """

    def __init__(self, message: str, report: ShownReport) -> None:
        super().__init__(message)
        self.report = report


def validate(
    target: str | os.PathLike[str] | type,
    *,
    contract: str = "arcade",
    sandbox: str = "auto",
    budget: str = "standard",
    checks: str | Sequence[str] | None = None,
    skip: str | Sequence[str] = (),
    seed: int = 0,
    env_class: str | None = None,
    kwargs: Mapping[str, Any] | None = None,
    wrappers: str | Sequence[str] = (),
    policy: str | None = None,
    time_limit: float | None = None,
    fail_fast: bool = False,
    exitfirst: bool = False,
    strict: bool = False,
    workers: int | None = None,
) -> ShownReport:
    """Validate environments in a sandbox, as ``envcraft validate`` does.

    Args:
        target: A file, a folder, ``package.module:Class``, a registered id, a class, or the text of a module. A text
            has a line break. A class of a script or a notebook is judged from its source.
        contract: What the environment promises.
        sandbox: ``auto``, ``docker``, ``bubblewrap`` or ``process``.
        budget: How much to play: ``quick``, ``standard`` or ``thorough``.
        checks: The checks to run, as a list or as in ``--checks``; None for all.
        skip: Checks not to run.
        seed: Seed of all episodes.
        env_class: The class, if a file or text defines several.
        kwargs: Arguments of the constructor, which JSON can represent.
        wrappers: ``module:func`` of a wrapper to apply, or of several, the innermost first.
        policy: A file with a privileged policy for the check ``difficulty``, or the name of a player that has one.
        time_limit: Seconds for each environment; None for the budget's.
        fail_fast: End each environment at its first error.
        exitfirst: End the run after the first environment that fails.
        strict: Treat warnings as errors, and undecided checks as failed.
        workers: The number of jobs that run in parallel; None for one per core.

    Returns:
        The report. It prints itself, and notebooks show it as HTML.

    Raises:
        UsageError: A name does not exist, a number is out of range, or the source of a class is not known.
        SandboxUnavailable: No sandbox of this kind works here.
    """
    selected = select_checks(None if checks is None else _joined(checks), _joined(skip) or None)
    severity = SeverityPolicy(severity_table(Path.cwd()), strict, comments=True)
    lookup("budget", str(budget), BUDGETS)
    _require_number("seed", seed, True, 0, _MAX_SEED)
    if time_limit is not None:
        _require_number("time_limit", time_limit, False, 0)
    if workers is not None:
        _require_number("workers", workers, True, 1)
    given, named = _json(kwargs or {}), _wrappers(wrappers)
    targets = [configured(each, given, named) for each in _targets(target, env_class)]
    with contextlib.closing(driver_named(sandbox)) as driver:
        plan = Plan(
            targets,
            contract_named(contract),
            driver,
            selected,
            BUDGETS[budget],
            seed,
            policy_named(policy) if policy else None,
            time_limit=time_limit,
            fail_fast=fail_fast,
            severity=severity,
        )
        report = _judged(plan, workers, exitfirst)
        record(plan, report)
        return report


def check_env(
    env: gymnasium.Env[Any, Any] | type | str | os.PathLike[str],
    warn: bool | None = True,
    skip_render_check: bool = False,
    skip_close_check: bool = False,
    *,
    contract: str = "gymnasium",
    sandbox: str = "auto",
    budget: str = "quick",
    seed: int = 0,
    kwargs: Mapping[str, Any] | None = None,
) -> None:
    """Check an environment, in place of the functions of this name of Gymnasium and stable-baselines3.

    A new instance of the same class, or of the same registered id, is judged in a sandbox. The instance itself is not
    stepped. Wrappers around it are left out, with a warning. So are arguments that an instance was made with and that
    are not known.

    Args:
        env: An instance, a class, a registered id, or another target of :func:`validate` with one environment.
        warn: Whether findings of the severity ``warning`` are Python warnings.
        skip_render_check: Leave out findings about rendering.
        skip_close_check: Leave out findings about ``close()``.
        contract: What the environment promises.
        sandbox: As for :func:`validate`.
        budget: As for :func:`validate`.
        seed: Seed of all episodes.
        kwargs: Arguments of the constructor. An instance of a registered id has its own.

    Raises:
        CheckFailed: The environment has defects: the message has each finding, and `report` everything. It is an
            AssertionError.
        UsageError: The source of the class is not known, an argument has no JSON, or `kwargs` lacks one that an
            instance needs.
        EnvCraftError: The environment could not be judged.
    """
    target, given = _checked(env, kwargs)
    left_out = [*(_RENDERING if skip_render_check else ()), *(_CLOSING if skip_close_check else ())]
    table = severity_table(Path.cwd()) | dict.fromkeys(left_out, OFF)
    target = msgspec.structs.replace(target, kwargs=_json(given))
    lookup("budget", str(budget), BUDGETS)
    _require_number("seed", seed, True, 0, _MAX_SEED)
    with contextlib.closing(driver_named(sandbox)) as driver:
        promised, selected = contract_named(contract), select_checks(None, None)
        severity = SeverityPolicy(table, comments=True)
        plan = Plan([target], promised, driver, selected, BUDGETS[budget], seed, severity=severity)
        report = _judged(plan)
    [subject] = report.reports
    rules = rules_of(plan.checks)
    found = [(finding, subject.file) for check in subject.checks for finding in check.findings]
    for finding, file in found:
        if warn and finding.severity is Severity.WARNING:
            warnings.warn(_words(finding, file), stacklevel=2)
    if subject.verdict is Verdict.ERROR:
        raise EnvCraftError(f"{subject.path} could not be judged: {subject.reason}")
    errors = [(finding, file) for finding, file in found if finding.severity is Severity.ERROR]
    if errors:
        lines = [f"{_words(finding, file)}\n  fix: {rules[finding.code].fix}" for finding, file in errors]
        raise CheckFailed("\n".join(lines), report)


def _judged(plan: Plan, workers: int | None = None, exitfirst: bool = False) -> ShownReport:
    with contextlib.closing(judge(plan, workers, exitfirst=exitfirst)) as events:
        [report] = [event.report for event in events if isinstance(event, Finished)]
    wrong = [check.reason for subject in report.reports for check in subject.checks if check.wrong_use]
    if wrong:
        # What a command calls an option is an argument here.
        option, colon, words = wrong[0].removeprefix("--").partition(":")
        raise UsageError(f"{'wrappers' if option == 'wrap' else option}{colon}{words}")
    return ShownReport.of(report)


def _words(finding: Finding, file: str) -> str:
    place = f"{file}:{finding.line}: " if finding.line else f"{file}: "
    return f"{place}{finding.code} {finding.message}"


def _targets(target: str | os.PathLike[str] | type, env_class: str | None) -> list[Target]:
    if isinstance(target, type):
        if env_class is not None:
            words = f"{env_class!r} does not apply to the class {target.__name__}; leave it out"
            raise UsageError(f"env_class {words}", setting="class")
        return [_class(target)]
    if isinstance(target, str) and "\n" in target:
        keep_source(target.encode())
        return [Target("source.py", target.encode(), env_class)]
    if isinstance(target, gymnasium.Env):
        name = type(target).__name__
        raise UsageError(f"validate() takes no instance; pass the class {name}, or call envcraft.check_env(env)")
    if not isinstance(target, str | os.PathLike):
        words = "give a file, a folder, a class, package.module:Class, an id or the text of a module"
        raise UsageError(f"{target!r} is not a target; {words}")
    return resolve(os.fspath(target), env_class)


def _checked(env: Any, kwargs: Mapping[str, Any] | None) -> tuple[Target, Mapping[str, Any]]:
    """The target of what a caller checks, with the arguments of its constructor: `kwargs`, else its own if known.

    Raises:
        UsageError: `env` cannot be judged, or not without arguments that are not known.
    """
    if isinstance(env, str | os.PathLike):
        targets = _targets(env, None)
        if len(targets) != 1:
            raise UsageError(f"{env} holds {len(targets)} environments; check_env() judges one, and validate() several")
        return targets[0], kwargs or {}
    if isinstance(env, type):
        return _class(env), kwargs or {}
    if not isinstance(env, gymnasium.Env):
        raise UsageError(f"{type(env).__name__} is not a gymnasium.Env; pass an environment, its class or its id")
    layers = []
    layer: Any = env
    while isinstance(layer, gymnasium.Wrapper):
        layers.append(type(layer).__name__)
        layer = layer.env
    if others := [name for name in layers if name not in _USUAL]:
        words = f"the environment is judged without its wrappers: {', '.join(others)}"
        warnings.warn(words, stacklevel=3)
    inner, spec = env.unwrapped, env.spec
    target = _class(type(inner))
    if kwargs is None and spec is not None:
        kwargs = {key: value for key, value in spec.kwargs.items() if key != "render_mode"}
    elif kwargs is None:
        _warn_of_arguments(inner)
        kwargs = {}
    if spec is not None and target.kind is Kind.MODULE:
        # Its package registers the id, with a limit of steps for example.
        return Target(f"{type(inner).__module__.partition('.')[0]}:{spec.id}", kind=Kind.ID), kwargs
    return target, kwargs


def _warn_of_arguments(env: gymnasium.Env[Any, Any]) -> None:
    """Warn if the constructor of an instance takes arguments, and the instance may not have their defaults.

    Raises:
        UsageError: the constructor needs arguments.
    """
    name = type(env).__qualname__
    try:
        parameters = list(inspect.signature(type(env)).parameters.values())
    except (ValueError, TypeError):
        return
    variadic = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    named = [each for each in parameters if each.kind not in variadic and each.name != "render_mode"]
    if needed := [each.name for each in named if each.default is each.empty]:
        example = ", ".join(f"{each!r}: ..." for each in needed)
        words = f"{name}() needs {', '.join(needed)}, and those of this instance are not known"
        raise UsageError(f"{words}; give them: kwargs={{{example}}}", setting="kwargs")
    unlike = [each.name for each in named if not _has_default(env, each)]
    if unlike:
        warnings.warn(
            f"{name}() is judged with the defaults of {', '.join(unlike)}, because the arguments of this instance are "
            f"not known; give those that differ: kwargs={{{unlike[0]!r}: ...}}",
            stacklevel=4,
        )


def _has_default(env: gymnasium.Env[Any, Any], parameter: inspect.Parameter) -> bool:
    """Whether an instance keeps a parameter under its name, with the value of the default."""
    kept = vars(env).get(parameter.name, vars(env).get(f"_{parameter.name}", _UNKNOWN))
    # Values of other types may compare in any way.
    return type(kept) is type(parameter.default) and isinstance(kept, _PLAIN) and kept == parameter.default


def _class(kind: type) -> Target:
    """The target of a class: its module if a worker can import that, else its source."""
    if not issubclass(kind, gymnasium.Env):
        raise UsageError(f"{kind.__qualname__} does not derive from gymnasium.Env")
    try:
        file = inspect.getsourcefile(kind)
    except (OSError, TypeError):
        file = None
    if kind.__module__ != "__main__" and file and is_installed(Path(file)):
        return Target(f"{kind.__module__}:{kind.__qualname__}", kind=Kind.MODULE)
    target = target_of(kind)
    keep_source(target.source)
    return with_project(target)


def _wrappers(names: str | Sequence[str]) -> tuple[str, ...]:
    """The names of wrappers. Raises UsageError if one is not ``module:func``."""
    found = (names,) if isinstance(names, str) else tuple(names)
    for name in found:
        if not isinstance(name, str) or kind_of(name) is not Kind.MODULE:
            words = f"the wrapper {name!r} must be 'module:func', such as 'gymnasium.wrappers:FlattenObservation'"
            raise UsageError(words, setting="wrap")
    return found


def _require_number(name: str, value: Any, whole: bool, least: int, most: float = math.inf) -> None:
    """Raise UsageError if an argument is not a number in a range; one that need not be whole must be above `least`."""
    fits = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    if not fits or not (least <= value <= most if whole else least < value < most):
        limits = f"from {least} to {most}" if most < math.inf else f"of {least} or more" if whole else f"above {least}"
        raise UsageError(f"{name} is {value!r}; it must be {'a whole number' if whole else 'a number'} {limits}")


def _joined(names: str | Sequence[str]) -> str:
    return names if isinstance(names, str) else ",".join(names)


def _json(kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments that reach the worker as they are. Raises UsageError."""
    if not isinstance(kwargs, Mapping):
        raise UsageError(f"kwargs is {kwargs!r}; it must be a dict, such as {{'size': 8}}", setting="kwargs")
    try:
        read = json.loads(json.dumps(dict(kwargs)))
    except (TypeError, ValueError) as error:
        raise UsageError(f"an argument of the constructor has no JSON: {error}") from None
    assert isinstance(read, dict)
    return read
