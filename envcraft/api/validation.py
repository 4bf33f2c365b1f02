"""``envcraft.validate`` and ``envcraft.check_env``."""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import msgspec

from envcraft.api.arguments import require_flags, require_values
from envcraft.api.cells import Cells
from envcraft.api.extraction import target_of
from envcraft.api.report import ShownReport
from envcraft.cli.commands.validate import is_excluded, read_kwargs, severity_of
from envcraft.cli.commands.validate import validate as command
from envcraft.cli.configured import of_the_file
from envcraft.cli.options import policy_of
from envcraft.contracts.lookup import contract_named
from envcraft.environments.targets import resolve
from envcraft.errors import EnvCraftError, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan
from envcraft.judging.engine import validate as judge
from envcraft.judging.installed import is_installed
from envcraft.judging.selection import driver_named, rules_of, select_checks
from envcraft.judging.severity import OFF
from envcraft.judging.verdict_cache import record
from envcraft.model.events import Finished
from envcraft.model.project import Place, configured, with_project
from envcraft.model.target import Kind, Target, kind_of
from envcraft.model.verdict import Finding, Severity, SubjectReport, Verdict
from envcraft.reports.evidence import keep_source, lines_below, place_of
from envcraft.text import plural

_Target = str | os.PathLike[str] | type
#: The parameter of each option of the command.
_PARAMETERS = {option.removeprefix("--"): str(each.name) for each in command.params for option in each.opts}

#: Wrappers that ``gymnasium.make`` adds, which say nothing about the environment.
_USUAL = ("OrderEnforcing", "PassiveEnvChecker")
#: The codes that the parameters of Gymnasium's check_env leave out.
_RENDERING, _CLOSING = ("EC112", "EC116", "EC117"), ("EC113",)

#: What an instance has that does not keep a parameter.
_UNKNOWN = object()
#: The types of values that compare as they look.
_PLAIN = (bool, int, float, str, type(None))


#: A command in a message, or an option with the space before its value: that is quoted, in capitals, or the last word.
_OPTION = re.compile(r"`[^`]*`|--([a-z][a-z-]*)( (?=['A-Z]|\w+$))?")


class CheckFailed(EnvCraftError, AssertionError):
    """An environment has defects. As with other checkers, this is an AssertionError.

    Attributes:
        report: the whole report.
    """

    def __init__(self, message: str, report: ShownReport) -> None:
        super().__init__(message)
        self.report = report


def validate(
    target: _Target | Sequence[_Target],
    *,
    contract: str | None = None,
    sandbox: str | None = None,
    runtime: str | None = None,
    require_isolation: str | None = None,
    budget: str | None = None,
    checks: str | Sequence[str] | None = None,
    skip: str | Sequence[str] | None = None,
    select: str | Sequence[str] | None = None,
    ignore: str | Sequence[str] | None = None,
    exclude: str | Sequence[str] | None = None,
    baseline: str | None = None,
    seed: int | None = None,
    env_class: str | None = None,
    kwargs: Mapping[str, Any] | None = None,
    wrappers: str | Sequence[str] | None = None,
    policy: str | None = None,
    time_limit: float | None = None,
    fail_fast: bool | None = None,
    exitfirst: bool | None = None,
    strict: bool | None = None,
    workers: int | None = None,
) -> ShownReport:
    """Validate environments in a sandbox, as ``envcraft validate`` does.

    An argument that is None has its value from ``[tool.envcraft]`` of the nearest ``pyproject.toml``, else the default
    of the command.

    Args:
        target: A file, a folder, ``package.module:Class``, a registered id, a class, or the text of a module; or a list
            of these. A text has a line break. A class of a script or a notebook is judged from its source.
        contract: What the environment promises; ``arcade`` by default.
        sandbox: ``auto``, ``docker``, ``bubblewrap`` or ``process``; ``auto`` by default.
        runtime: The container runtime of the docker sandbox.
        require_isolation: The isolation level that the sandbox must have.
        budget: How much to play: ``quick``, ``standard`` or ``thorough``; ``standard`` by default.
        checks: The checks to run, as a list or as in ``--checks``; all by default.
        skip: Checks not to run.
        select: The rules that report: codes or their first characters.
        ignore: The rules that do not report: codes or their first characters.
        exclude: Patterns of files that are skipped in folders.
        baseline: A report whose findings do not count.
        seed: Seed of all episodes; 0 by default.
        env_class: The class, if a file or text defines several.
        kwargs: Arguments of the constructor, which JSON can represent.
        wrappers: ``module:func`` of a wrapper to apply, or of several, the innermost first. A module is installed, in
            the working directory, or in the project of a file.
        policy: A file with a privileged policy for the check ``difficulty``, or the name of a player that has one.
        time_limit: Seconds for each environment; by default the budget's.
        fail_fast: End each environment at its first error.
        exitfirst: End the run after the first environment that fails.
        strict: Treat warnings as errors, and undecided checks as failed.
        workers: The number of jobs that run in parallel; one per core by default.

    Returns:
        The report. It prints itself, and notebooks show it as HTML.

    Raises:
        UsageError: A name does not exist, a value has another type or is out of range, or the source of a class is not
            known.
        SandboxUnavailable: No sandbox of this kind works here.
    """
    given = {
        "contract": contract,
        "sandbox": sandbox,
        "runtime": runtime,
        "require_isolation": require_isolation,
        "budget": budget,
        "checks": checks,
        "skip": skip,
        "select": select,
        "ignore": ignore,
        "exclude": exclude,
        "baseline": baseline,
        "seed": seed,
        "env_class": env_class,
        "kwargs": kwargs,
        "wrap": wrappers,
        "policy": policy,
        "time_limit": time_limit,
        "fail_fast": fail_fast,
        "exitfirst": exitfirst,
        "strict": strict,
        "workers": workers,
    }
    with _options(given) as options:
        arguments = _json(kwargs) if kwargs is not None else read_kwargs(options.get("kwargs"))
        named = _wrappers(options.get("wrap", ()))
        patterns = _listed(options.get("exclude", ()))
        targets: dict[tuple[str, str], Target] = {}
        several: Sequence[Any] = target if isinstance(target, list | tuple) else [target]
        if not several:
            raise UsageError("no target is given; give a file, a folder, a class, package.module:Class or an id")
        for one in several:
            # A project's class is that of its files.
            wanted = env_class if isinstance(one, type) else options.get("env_class")
            for each in _targets(one, wanted, patterns):
                targets.setdefault((each.path, each.sha256), configured(each, arguments, named))
        plan, report = _judged(list(targets.values()), options)
        record(plan, report)
        return report


#: The argument of :func:`validate` for each parameter of the command that has one.
_KEYWORDS = {
    {"wrappers": "wrap"}.get(name, name): name for name in inspect.signature(validate).parameters if name != "target"
}


def check_env(
    env: gymnasium.Env[Any, Any] | type | str | os.PathLike[str],
    warn: bool | None = True,
    skip_render_check: bool = False,
    skip_close_check: bool = False,
    *,
    contract: str = "gymnasium",
    sandbox: str | None = None,
    budget: str = "quick",
    seed: int | None = None,
    kwargs: Mapping[str, Any] | None = None,
) -> None:
    """Check an environment. This replaces the function of the same name in Gymnasium and stable-baselines3.

    A new instance of the same class, or of the same registered id, is judged in a sandbox. The instance itself is not
    stepped. Wrappers around it are left out, with a warning. Unknown constructor arguments of an instance are left out,
    too, with a warning. The settings of ``[tool.envcraft]`` apply as in :func:`validate`, except the contract, the
    budget and those that say what is judged.

    Args:
        env: An instance, a class, a registered id, or another target of :func:`validate` with one environment.
        warn: Whether findings of the severity ``warning`` are Python warnings.
        skip_render_check: Leave out findings about rendering.
        skip_close_check: Leave out findings about ``close()``.
        contract: What the environment promises.
        sandbox: As for :func:`validate`.
        budget: As for :func:`validate`.
        seed: As for :func:`validate`.
        kwargs: Arguments of the constructor. An instance of a registered id has its own.

    Raises:
        CheckFailed: The environment has defects: the message has each finding, and `report` everything. It is an
            AssertionError.
        UsageError: The source of the class is not known, a value has another type, an argument has no JSON, or `kwargs`
            lacks one that an instance needs.
        EnvCraftError: The environment could not be judged.
    """
    flags = {"skip_render_check": skip_render_check, "skip_close_check": skip_close_check}
    require_flags(flags if warn is None else {"warn": warn, **flags})
    target, given, limit = _checked(env, kwargs)
    left_out = [*(_RENDERING if skip_render_check else ()), *(_CLOSING if skip_close_check else ())]
    target = msgspec.structs.replace(target, kwargs=_json(given))
    with _options({"contract": contract, "sandbox": sandbox, "budget": budget, "seed": seed}) as options:
        plan, report = _judged([target], options, dict.fromkeys(left_out, OFF), limit)
    [subject] = report.reports
    rules = rules_of(plan.checks)
    found = [finding for check in subject.checks for finding in check.findings]
    for finding in found:
        if warn and finding.severity is Severity.WARNING:
            warnings.warn(_words(subject, finding), stacklevel=2)
    if subject.verdict is Verdict.ERROR:
        raise EnvCraftError(f"{subject.path} could not be judged: {subject.reason}")
    lines = []
    for finding in (each for each in found if each.severity is Severity.ERROR):
        lines += [_words(subject, finding), *lines_below(subject, finding), f"  fix: {rules[finding.code].fix}"]
    # A strict run fails checks that are undecided.
    failed = [check for check in subject.checks if check.verdict is Verdict.FAIL and check.undecided]
    lines += [f"{subject.file}: {check.check} is undecided: {check.reason}" for check in failed]
    if lines:
        raise CheckFailed("\n".join(lines), report)


@contextlib.contextmanager
def _options(given: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Join the arguments of a call and the settings of the project, by parameter of ``envcraft validate``.

    Within the context an error names the argument, or the file and the setting, where it would name an option.

    Args:
        given: The arguments of the call; those that are None are not given.

    Raises:
        UsageError: A setting or its value does not exist, or the context raises one.
    """
    folder = Path.cwd()
    given = {
        name: os.fspath(value) if isinstance(value, os.PathLike) else value
        for name, value in given.items()
        if value is not None
    }
    require_values(given, command.params, _KEYWORDS)
    settings = command.read(folder)
    try:
        yield {**settings, **given}
    except UsageError as error:
        name = _PARAMETERS.get(error.setting)
        if name in settings and name not in given:
            raise of_the_file(error, folder) from None
        raise UsageError(_OPTION.sub(_keyword, str(error)), setting=error.setting) from None


def _keyword(option: re.Match[str]) -> str:
    """What Python calls an option of the command; a command in backticks stays as it is."""
    name = _PARAMETERS.get(option[1], "")
    if name not in _KEYWORDS:
        return option[0]
    return f"{_KEYWORDS[name]}{'=' if option[2] else ''}"


def _judged(
    targets: list[Target], options: dict[str, Any], table: Mapping[str, str] | None = None, limit: int | None = None
) -> tuple[Plan, ShownReport]:
    """Judge targets under the options of a call.

    Args:
        targets: What to judge.
        options: Values by parameter of ``envcraft validate``.
        table: Severities that win over those of the project.
        limit: The number of steps after which episodes are truncated, besides what the contract says.

    Raises:
        UsageError: An option is wrong.
        SandboxUnavailable: No sandbox of this kind works here.
    """
    severity = severity_of(
        Path.cwd(),
        bool(options.get("strict")),
        _joined(options.get("select")),
        _joined(options.get("ignore")),
        options.get("baseline"),
        table,
    )
    selected = select_checks(
        _joined(options.get("checks")), _joined(options.get("skip")) or None, severity.select, severity.ignore
    )
    promised = contract_named(options.get("contract", "arcade"))
    if limit is not None:
        promised = msgspec.structs.replace(promised, adapter={**promised.adapter, "limit": limit})
    sandbox = options.get("sandbox", "auto"), options.get("require_isolation"), options.get("runtime")
    with contextlib.closing(driver_named(*sandbox)) as driver:
        plan = Plan(
            targets,
            promised,
            driver,
            selected,
            BUDGETS[options.get("budget", "standard")],
            options.get("seed", 0),
            policy_of(options.get("policy")),
            time_limit=options.get("time_limit"),
            fail_fast=bool(options.get("fail_fast")),
            severity=severity,
        )
        with contextlib.closing(
            judge(plan, options.get("workers"), exitfirst=bool(options.get("exitfirst")))
        ) as events:
            [report] = [event.report for event in events if isinstance(event, Finished)]
    wrong = [check.reason for subject in report.reports for check in subject.checks if check.wrong_use]
    if wrong:
        raise UsageError(wrong[0], setting=wrong[0].removeprefix("--").partition(":")[0])
    in_cells = {target.sha256: Cells(target.path, target.cells) for target in targets if target.cells}
    for subject in report.reports:
        if subject.source_sha256 in in_cells:
            for check in subject.checks:
                in_cells[subject.source_sha256].within(check)
    return plan, ShownReport.of(report)


def _words(subject: SubjectReport, finding: Finding) -> str:
    return f"{place_of(subject, finding)}: {finding.code} {finding.message}"


def _targets(target: _Target, env_class: str | None, exclude: tuple[str, ...] = ()) -> list[Target]:
    if isinstance(target, type):
        if env_class is not None:
            words = f"{env_class!r} does not apply to the class {target.__name__}; leave it out"
            raise UsageError(f"env_class {words}", setting="class")
        return [_class(target)]
    if isinstance(target, str) and "\n" in target:
        keep_source(target.encode())
        return [Target("source.py", target.encode(), env_class)]
    if isinstance(target, gymnasium.Env):
        name = type(target.unwrapped).__name__
        raise UsageError(f"validate() takes no instance; pass the class {name}, or call envcraft.check_env(env)")
    if not isinstance(target, str | os.PathLike):
        words = "give a file, a folder, a class, package.module:Class, an id or the text of a module"
        raise UsageError(f"{target!r} is not a target; {words}")
    path = os.fspath(target)
    found = resolve(path, env_class)
    if not exclude or not os.path.isdir(path):
        return found
    kept = [each for each in found if not is_excluded(each.path, path, exclude)]
    if not kept:
        words = f"--exclude leaves none of {plural(len(found), 'environment')}; leave out a pattern"
        raise UsageError(words, setting="exclude")
    return kept


class _Checked(NamedTuple):
    """What a caller checks, the arguments of its constructor, and the limit of a ``TimeLimit`` that no worker adds."""

    target: Target
    kwargs: Mapping[str, Any]
    limit: int | None = None


def _checked(env: Any, kwargs: Mapping[str, Any] | None) -> _Checked:
    """Find what a caller checks, with the arguments of its constructor: `kwargs`, else its own if known.

    Raises:
        UsageError: `env` cannot be judged, or not without arguments that are not known.
    """
    own = gymnasium.registry.get(env) if isinstance(env, str) else None
    if own is not None and isinstance(own.entry_point, type) and _class(own.entry_point).kind is Kind.SOURCE:
        # A script or a notebook has registered the id, and a worker does not run those.
        return _Checked(_class(own.entry_point), own.kwargs if kwargs is None else kwargs, own.max_episode_steps)
    if isinstance(env, str | os.PathLike):
        targets = _targets(env, None)
        if len(targets) != 1:
            raise UsageError(f"{env} holds {len(targets)} environments; check_env() judges one, and validate() several")
        return _Checked(targets[0], kwargs or {})
    if isinstance(env, type):
        return _Checked(_class(env), kwargs or {})
    if not isinstance(env, gymnasium.Env):
        raise UsageError(
            f"{type(env).__name__} is not a gymnasium.Env; pass an environment, its class, its id or its file"
        )
    layers = []
    limit: int | None = None
    layer: Any = env
    while isinstance(layer, gymnasium.Wrapper):
        if type(layer) is gymnasium.wrappers.TimeLimit:
            limit = min(layer._max_episode_steps, limit or layer._max_episode_steps)
        else:
            layers.append(type(layer).__name__)
        layer = layer.env
    inner, spec = env.unwrapped, env.spec
    target = _class(type(inner))
    registered = spec is not None and target.kind is Kind.MODULE
    if others := [name for name in layers if name not in _USUAL]:
        words = f"the environment is judged without its wrappers: {', '.join(others)}"
        warnings.warn(words, stacklevel=3)
    if kwargs is None and spec is not None:
        kwargs = {key: value for key, value in spec.kwargs.items() if key != "render_mode"}
    elif kwargs is None:
        _warn_of_arguments(inner)
        kwargs = {}
    if spec is not None and registered:
        # Its package registers the id, and the worker's own gymnasium.make adds the limit of the registry.
        known = gymnasium.registry.get(spec.id)
        added = None if known is not None and limit == known.max_episode_steps else limit
        return _Checked(Target(f"{type(inner).__module__.partition('.')[0]}:{spec.id}", kind=Kind.ID), kwargs, added)
    return _Checked(target, kwargs, limit)


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
        words = f"{name}() needs {', '.join(needed)}, and an instance does not say what it was made with"
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
    keep_source(target.source, target.cells)
    return with_project(target, _root(kind, Path(file)) if file else None)


def _root(kind: type, file: Path) -> Path | None:
    """The folder that a class was imported from, where no ``__init__.py`` beside its file shows it."""
    parts = kind.__module__.split(".")
    if len(parts) == 1 or Place.of(file).module == kind.__module__:
        return None
    root = file.absolute().parents[len(parts) - 1]
    return root if Path(root, *parts).with_suffix(".py") == file.absolute() else None


def _wrappers(names: str | Sequence[str]) -> tuple[str, ...]:
    """The names of wrappers. Raises UsageError if one is not ``module:func``."""
    found = _listed(names)
    for name in found:
        if not isinstance(name, str) or kind_of(name) is not Kind.MODULE:
            words = f"the wrapper {name!r} must be 'module:func', such as 'gymnasium.wrappers:FlattenObservation'"
            raise UsageError(words, setting="wrap")
    return found


def _listed(names: str | Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def _joined(names: str | Sequence[str] | None) -> str | None:
    return None if names is None else ",".join(_listed(names))


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
