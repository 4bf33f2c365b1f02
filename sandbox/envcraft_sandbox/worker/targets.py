"""The source of an environment: the text of a file, a class of an installed package, or a registered id.

Everything here imports and calls untrusted code and runs in a job. The caller catches its exceptions.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import linecache
import os
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from functools import lru_cache
from types import ModuleType
from typing import Any

import gymnasium
from envcraft_protocol import jobs
from envcraft_protocol.classes import concrete_classes, implements, is_environment, rendering

from . import project
from .marks import Marked, Reached

#: The name of the module that a source is executed in.
SUBJECT = "envcraft_subject"
#: Minimum length of the common prefix of an id and a package that is imported because of it.
_ALIKE = 3
#: How alike the names of two packages must be: one that is not installed may resemble another.
_SAME = 0.85
#: Maximum number of environments that a message names.
_MOST_NAMED = 20


class NoSuchEnvironment(LookupError):
    """The module has no such class, or no package registers the id."""


class NoSuchWrapper(LookupError):
    """The target names a wrapper that does not exist, or that wraps no environment."""


class Target(ABC):
    """A target as the job describes it."""

    def __init__(self, spec: jobs.Target) -> None:
        self.kwargs: dict[str, Any] = spec.get("kwargs") or {}
        self._wrappers: list[str] = spec.get("wrappers") or []
        self._project = spec.get("project")
        #: The file whose lines findings name, once known.
        self.filename = ""
        #: Which marks were reached; empty without marks.
        self.reached = Reached()

    @abstractmethod
    def load(self) -> None:
        """Import the module that defines the environment."""

    @abstractmethod
    def creator(self) -> Any:
        """The class or function that creates an instance."""

    def make(self, creator: Any, rendered: bool = True) -> Any:
        """An instance with the target's own wrappers, if it is `rendered` in the mode of :func:`rendering`."""
        shown = rendering(creator, self.kwargs) if rendered else {}
        env = creator(**self.kwargs | shown)
        return self.wrap(env)

    def column(self, line: int | None, column: int | None) -> int | None:
        """The column of the file that a column of the running code stands for, both in bytes."""
        return column

    def wrapper(self, name: str) -> Any:
        """The wrapper that ``module:func`` names. Raises NoSuchWrapper."""
        return _wrapper(name)

    def wrap(self, env: Any) -> Any:
        for name in self._wrappers:
            wrapper = self.wrapper(name)
            _require_wrapper(name, wrapper, env)
            env = wrapper(env)
            if not (hasattr(env, "reset") and hasattr(env, "step")):
                raise NoSuchWrapper(f"{name} returns a {type(env).__name__}, not an environment")
        return env


class Source(Target):
    """The text of a file, executed as a module, with marks at these places."""

    def __init__(self, spec: jobs.SourceTarget, places: Sequence[Sequence[int]] = ()) -> None:
        super().__init__(spec)
        self.filename = self._project["path"] if self._project else spec["filename"]
        self.module: ModuleType | None = None
        #: The name that the module has.
        self.name = SUBJECT
        if self._project is not None and project.in_package(self._project):
            self.name = self._project["module"]
        self.wanted: str | None = spec.get("class")
        self._source: str = spec["source"]
        self._places = tuple((line, column) for line, column in places)
        self._marked: Marked | None = None

    def load(self) -> None:
        if self.module is None:
            self._marked = _compiled(self._source, self.filename, self._places)
            self.reached = self._marked.reached
            self.reached.forget()
            self.module = self._executed(self._marked)

    def _executed(self, marked: Marked) -> ModuleType:
        if self._project is None:
            return _executed(SUBJECT, self._source, marked)
        project.lay_out(self._project, self._source)
        if self.name == SUBJECT:
            return _executed(SUBJECT, self._source, marked)
        _remember(self.filename, self._source)
        module = project.import_target(self._project, marked.code)
        if module is None:
            self.name = SUBJECT
            around = self._project["module"].rpartition(".")[0]
            return _executed(SUBJECT, self._source, marked, {"__package__": around})
        return module

    def wrapper(self, name: str) -> Any:
        module, _, func = name.partition(":")
        own = self._project["module"] if self._project else os.path.splitext(os.path.basename(self.filename))[0]
        # A file that is no part of a project is not where imports look.
        return getattr(self.module, func) if module == own and hasattr(self.module, func) else super().wrapper(name)

    def column(self, line: int | None, column: int | None) -> int | None:
        return self._marked.column(line, column) if self._marked is not None else column

    def creator(self) -> Any:
        assert self.module is not None, "load() comes first"
        # The search for classes reads their source, which takes longer than the start of a short episode.
        names = [self.wanted] if self.wanted else concrete_classes(self.module)
        if len(names) != 1 or not hasattr(self.module, names[0]):
            raise NoSuchEnvironment(f"{len(names)} classes")
        return getattr(self.module, names[0])


class _OfPackage(Target):
    """What is installed, perhaps with wrappers that are not."""

    def load(self) -> None:
        if self._project is not None:
            project.lay_out(self._project, None)
            self._project = None


class Installed(_OfPackage):
    """A class, or a function that creates environments, of an installed package."""

    def __init__(self, spec: jobs.ModuleTarget) -> None:
        super().__init__(spec)
        self._module: str = spec["module"]
        self._name: str = spec["class"]

    def load(self) -> None:
        super().load()
        top = self._module.partition(".")[0]
        if not _importable(top) and (near := _suggest(top, _packages(), cutoff=_SAME)):
            raise NoSuchEnvironment(f"no installed package is named {top}{near}")
        importlib.import_module(self._module)

    def creator(self) -> Any:
        try:
            found = attribute(f"{self._module}:{self._name}")
        except AttributeError:
            found = None
        if callable(found):
            return found
        module = sys.modules[self._module]
        names = [
            name
            for name, value in list(vars(module).items())
            if is_environment(value) and not issubclass(value, gymnasium.Wrapper)
        ]
        # An id without its version looks like a class.
        ids = _ids_of(self._module)
        there = "; it has no environment"
        if names:
            there = f"; its environments are {', '.join(names[:_MOST_NAMED])}"
        elif ids:
            there = f"; it registers {', '.join(ids[:_MOST_NAMED])}"
        near = _suggest(self._name, names) or _suggest(self._name, ids, f"{self._module}:")
        raise NoSuchEnvironment(f"{self._module} has no class {self._name}{near or there}")


class Registered(_OfPackage):
    """An id in Gymnasium's registry, made as ``gymnasium.make`` does but without its checking wrapper."""

    def __init__(self, spec: jobs.RegisteredTarget) -> None:
        super().__init__(spec)
        self._id: str = spec["id"]
        self.spec: Any = None

    def load(self) -> None:
        super().load()
        if self.spec is None:
            self.spec = find_spec(self._id)

    def creator(self) -> Any:
        entry: Any = self.spec.entry_point
        return attribute(entry) if isinstance(entry, str) else entry

    def make(self, creator: Any, rendered: bool = True) -> Any:
        shown = rendering(creator, {**self.spec.kwargs, **self.kwargs}) if rendered else {}
        env = gymnasium.make(self.spec, disable_env_checker=True, **self.kwargs | shown)
        return self.wrap(env)


def open_target(spec: jobs.Target, places: Sequence[Sequence[int]] = ()) -> Target:
    """The target of a job. Only a file has marks at `places`."""
    if spec["kind"] == "source":
        return Source(spec, places)
    return Installed(spec) if spec["kind"] == "module" else Registered(spec)


def execute(name: str, source: str, filename: str, extra: dict[str, Any] | None = None) -> ModuleType:
    """Execute a text as the module `name`."""
    return _executed(name, source, _compiled(source, filename, ()), extra)


def _executed(name: str, source: str, marked: Marked, extra: dict[str, Any] | None = None) -> ModuleType:
    module = ModuleType(name)
    filename = marked.code.co_filename
    module.__file__ = filename
    module.__dict__.update(extra or {})
    sys.modules[name] = module
    _remember(filename, source)
    exec(marked.code, module.__dict__)  # noqa: S102 (that is what a sandbox is for)
    return module


def _remember(filename: str, source: str) -> None:
    """Let tracebacks and `inspect` find the lines of a source."""
    linecache.cache[filename] = (len(source), None, source.splitlines(keepends=True), filename)


@lru_cache(maxsize=2)
def _compiled(source: str, filename: str, places: tuple[tuple[int, int], ...]) -> Marked:
    """The code of a text, which every job of a series executes again."""
    return Marked(source, filename, places)


def attribute(name: str) -> Any:
    """The object that ``package.module:Class.attribute`` names."""
    module, _, path = name.partition(":")
    found: Any = importlib.import_module(module)
    for part in path.split("."):
        found = getattr(found, part)
    return found


def _wrapper(name: str) -> Any:
    """The wrapper that ``module:func`` names. Raises NoSuchWrapper."""
    module = name.partition(":")[0]
    try:
        return attribute(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise
        raise NoSuchWrapper(f"the module {module} of the wrapper {name} is not installed") from None
    except AttributeError:
        known = [each for each, value in list(vars(sys.modules[module]).items()) if callable(value)]
        func = name.partition(":")[2]
        raise NoSuchWrapper(f"{module} has no wrapper {func}{_suggest(func, known)}") from None


def _require_wrapper(name: str, wrapper: Any, env: Any) -> None:
    """Raise NoSuchWrapper if a call with only an environment is not possible."""
    if not callable(wrapper):
        raise NoSuchWrapper(f"{name} is a {type(wrapper).__name__}, not a wrapper")
    try:
        signature = inspect.signature(wrapper)
    except (ValueError, TypeError):
        return
    try:
        signature.bind(env)
    except TypeError as error:
        words = f"{name} cannot wrap an environment without other arguments: {error}"
        raise NoSuchWrapper(f"{words}; write a function of one argument that passes them") from None


def find_spec(wanted: str) -> Any:
    """The entry of an id in the registry, after imports that may register it. Raises NoSuchEnvironment."""
    module, _, name = wanted.rpartition(":")
    if module:
        # `module:Id`, or an abbreviation of the module's name.
        packages = [module] if _importable(module) else _packages_like(module)
        if not packages:
            raise NoSuchEnvironment(
                f"no installed package is named {module}{_suggest(module, _packages(), cutoff=_SAME)}"
            )
        for candidate in packages:
            importlib.import_module(candidate)
            _register(candidate)
        found = _look_up(name)
        if found is not None:
            return found
    elif (found := _look_up(name)) is not None:
        return found
    else:
        for package in _packages_like(name.partition("/")[0] if "/" in name else name):
            _try_import(package)
            _register(package)
            if (found := _look_up(name)) is not None:
                return found
    _register(None)
    if (found := _look_up(name)) is not None:
        return found
    near = _suggest(name, list(gymnasium.registry))
    if module:
        own = ", ".join(_ids_of(packages[0])[:_MOST_NAMED])
        raise NoSuchEnvironment(f"the package {module} registers no {name}{near or (own and f'; it registers {own}')}")
    hint = near or "; write MODULE:ID to say which module registers it"
    raise NoSuchEnvironment(f"no installed package registers {name}{hint}")


def _look_up(name: str) -> Any:
    """Look up the whole id, or its name alone if only one namespace has it."""
    if name in gymnasium.registry:
        return gymnasium.registry[name]
    ends = [spec for key, spec in gymnasium.registry.items() if key.endswith("/" + name)]
    return ends[0] if len(ends) == 1 else None


def _packages_like(name: str) -> list[str]:
    """Top-level modules whose name is a prefix of `name` or the reverse; the most similar first."""
    plain = _plain(re.split(r"-v?\d|-", name)[0]) or _plain(name)
    alike = [
        package
        for package in _packages()
        if len(plain) >= _ALIKE
        and len(_plain(package)) >= _ALIKE
        and (_plain(package).startswith(plain) or plain.startswith(_plain(package)))
    ]
    if plain.isidentifier() and _importable(plain):
        # A module on the path may belong to no distribution.
        alike.append(plain)
    return sorted(set(alike), key=lambda package: (abs(len(_plain(package)) - len(plain)), package))


def _packages() -> list[str]:
    """The top-level modules of all distributions."""
    # Slow to import, and needed only for ids that are not registered yet, and for names that do not exist.
    import importlib.metadata

    return [package for package in importlib.metadata.packages_distributions() if package.isidentifier()]


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _register(package: str | None) -> None:
    """Call the entry points by which one package, or all packages, register their environments."""
    import importlib.metadata

    for point in importlib.metadata.entry_points(group="gymnasium.envs"):
        if package is None or point.module.partition(".")[0] == package:
            try:
                register = point.load()
                if callable(register):
                    register()
            except Exception as error:
                # The failure of another package does not concern this environment.
                sys.stderr.write(f"{point.value} cannot register its environments: {error}\n")


def _try_import(package: str) -> None:
    try:
        importlib.import_module(package)
    except Exception as error:
        sys.stderr.write(f"{package} cannot be imported: {error}\n")


def _importable(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False


def _suggest(name: str, known: Iterable[str], before: str = "", cutoff: float = 0.7) -> str:
    """Words with the id whose name is nearest, after `before`; "" if none is near. A common version alone makes no two
    ids alike.
    """
    import difflib

    names = {_unversioned(other): other for other in _newest(known)}
    near = difflib.get_close_matches(_unversioned(name), names, n=1, cutoff=cutoff)
    return f"; did you mean {before}{names[near[0]]}?" if near else ""


def _ids_of(module: str) -> list[str]:
    """The newest version of each id that the package of a module registers."""
    starts = tuple(f"{module.partition('.')[0]}{sign}" for sign in ".:")
    return list(_newest(key for key, spec in gymnasium.registry.items() if str(spec.entry_point).startswith(starts)))


def _newest(ids: Iterable[str]) -> Iterable[str]:
    """The last of the ids that differ in their versions only."""
    return {_unversioned(each): each for each in ids}.values()


def _unversioned(name: str) -> str:
    return name.rpartition("-v")[0].lower() or name.lower()


def lookalikes(module: ModuleType) -> list[str]:
    """Names of the classes that have ``reset`` and ``step`` but are not environments."""
    return [
        name
        for name, value in list(vars(module).items())
        if inspect.isclass(value)
        and value.__module__ == module.__name__
        and not issubclass(value, gymnasium.Env)
        and looks_alike(value)
    ]


def looks_alike(value: Any) -> bool:
    """Whether a class or an object has ``reset`` and ``step``."""
    return callable(getattr(value, "reset", None)) and callable(getattr(value, "step", None))


def unfinished(module: ModuleType) -> dict[type, tuple[list[str], list[list[str]]]]:
    """The environments of a module that leave methods to subclasses, without those that others derive from.

    Returns:
        Of each class, which of ``reset`` and ``step`` it lacks; and its abstract methods, or else those of the two that
        do nothing or only raise, each with the class that defines it.
    """
    found = {}
    for name, value in list(vars(module).items()):
        if not is_environment(value) or value.__module__ != module.__name__ or value.__name__ != name:
            continue
        lacks = [each for each in ("reset", "step") if getattr(value, each) is getattr(gymnasium.Env, each)]
        empty = [each for each in ("reset", "step") if each not in lacks and not implements(value, each)]
        # A class without a metaclass for it may declare methods abstract, too.
        declared = [each for each in dir(value) if getattr(getattr(value, each, None), "__isabstractmethod__", False)]
        names = declared or empty
        owners = [[each, next(part.__name__ for part in value.__mro__ if each in vars(part))] for each in names]
        if (owners or lacks) and not issubclass(value, gymnasium.Wrapper):
            found[value] = lacks, owners
    return {kind: left for kind, left in found.items() if not any(kind in other.__mro__[1:] for other in found)}


def wrappers(module: ModuleType) -> list[str]:
    """Names of the wrappers that a module defines."""
    return [
        name
        for name, value in list(vars(module).items())
        if inspect.isclass(value) and value.__module__ == module.__name__ and issubclass(value, gymnasium.Wrapper)
    ]


def required_arguments(kind: Any, given: dict[str, Any]) -> list[str]:
    """The parameters of a constructor that have no default and are not given; [] if it refuses what is given."""
    try:
        parameters = inspect.signature(kind).parameters.values()
    except (ValueError, TypeError):
        return []
    kinds = {parameter.kind for parameter in parameters}
    if inspect.Parameter.VAR_KEYWORD not in kinds and not given.keys() <= {parameter.name for parameter in parameters}:
        return []
    return [
        parameter.name
        for parameter in parameters
        if parameter.default is parameter.empty
        and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        and parameter.name not in given
    ]
