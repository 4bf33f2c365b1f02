"""Load the code under test and call it. Whatever the code does becomes a report and never unwinds the worker."""

from __future__ import annotations

import ast
import hashlib
import inspect
import linecache
import os
import random
import re
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from types import CodeType, ModuleType
from typing import Any

import gymnasium
import numpy as np
from envcraft_protocol import adapters, jobs
from envcraft_protocol.classes import concrete_classes, definitions, rendering, type_name
from envcraft_protocol.spaces import Form, decode_action
from envcraft_protocol.spaces import describe as describe_space
from envcraft_protocol.wire import Kind

from . import targets
from .channel import Channel, jsonable
from .own_time import OwnTime

_POLICY = "envcraft_policy"
#: Keys of metadata that versions of Gym before 0.22 had.
_OLD_KEYS = ("render.modes", "video.frames_per_second")
#: The highest number of frames per second that is passed on.
_FASTEST = 1_000
#: Parts of the file names of frames that are not part of the subject: those of the worker and of Python's imports.
_OTHER_FRAMES = ("envcraft_sandbox", "envcraft_protocol", "<frozen importlib", "importlib/__init__.py")
#: Number of frames at the end of a traceback that are shown.
_MOST_FRAMES = 8
#: Maximum number of module names in a description.
_MAX_MODULES = 5_000
#: Maximum length of a name in a description.
_MAX_NAME = 1_000
_METHODS = ("__init__", "reset", "step", "render", "close")


class Fault(Exception):
    """The subject failed in a call, as described by `report`."""

    def __init__(self, report: dict[str, Any]) -> None:
        super().__init__(report.get("message", ""))
        self.report = report


class Subject:
    """The environment's class, and the calls on its instances."""

    def __init__(self, job: jobs.Job, channel: Channel) -> None:
        self.channel = channel
        self.contract: jobs.Contract = job["contract"]
        self.action_spec: dict[str, Any] | None = self.contract.get("action")
        self.target = targets.open_target(job["target"], job.get("marks", ()))
        self._creator: Any = None
        self._folder = os.getcwd()
        #: The folder of the top-level package that has an installed class, "" if it is not known.
        self._package = ""

    def call(self, phase: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call untrusted code, or code that examines its values. Any exception, also SystemExit, becomes a Fault of
        `phase`.
        """
        try:
            return function(*args, **kwargs)
        except BaseException as error:
            raise Fault(self._report(phase, error)) from None

    def step(self, phase: str, env: Any, value: Any) -> Any:
        """Step an instance with an action as JSON, and count the call."""
        action = self.action(value, env)
        self.channel.steps += 1
        return self.call(phase, env.step, action)

    def load(self) -> None:
        """Import the module that defines the environment."""
        self.channel.phase("import")
        self.call("import", self.target.load)

    def creator(self) -> Any:
        """The class or function that creates an instance."""
        if self._creator is None:
            self.load()
            self._creator = self.call("import", self.target.creator)
            self._name_file(self._creator)
        return self._creator

    def construct(self, announce: bool = True, resize: bool = False, rendered: bool = True) -> Any:
        """Create an instance, adapted to the contract, if it is `rendered` with ``render_mode="rgb_array"`` where the
        constructor accepts that. Without `resize`, the channel resizes the frames that are looked at.
        """
        creator = self.creator()
        if announce:
            self.channel.phase("construct")
        env = self.call("construct", self.target.make, creator, rendered)
        if isinstance(env, gymnasium.Env):
            self.call("construct", lambda: self._name_file(type(env.unwrapped)))
        adapter = self.contract.get("adapter") or {}
        return adapters.apply(env, {name: adapter[name] for name in adapter if resize or name != "resize"})

    def _name_file(self, kind: Any) -> None:
        """Let findings about an installed class name lines of the file that defines it."""
        if not isinstance(self.target, targets.Source) and inspect.isclass(kind):
            self.target.filename = _source_file(kind) or self.target.filename
            package = sys.modules.get(kind.__module__.partition(".")[0])
            self._package = os.path.dirname(_source_file(package) or "") if hasattr(package, "__path__") else ""

    def action(self, value: Any, env: Any, form: Form = "own") -> Any:
        spec = self.action_spec
        if spec is None:
            spec = self.action_spec = describe_space(env.action_space)
        return decode_action(spec, value, form)

    def load_policy(self, policy: jobs.Policy) -> ModuleType:
        self.channel.phase("policy")
        module: ModuleType = self.call(
            "policy", targets.execute, _POLICY, policy["source"], policy["filename"], {"np": np}
        )
        return module

    def describe(self) -> None:
        """Send what the target defines: its classes, the spaces of an instance, and side effects of the import."""
        before = (random.getstate(), np.random.get_state(legacy=False)["state"]["key"].copy(), threading.active_count())
        known = set(sys.modules)
        if isinstance(self.target, targets.Source):
            # A library's warning about this machine, such as about missing fonts, is not output of the file.
            warnings.filterwarnings("ignore", module=rf"(?!{re.escape(self.target.name)}\Z)")
        with OwnTime(self._folder) as own_time:
            self.load()
        effects = {
            "seconds": own_time.seconds,
            "random": random.getstate() != before[0],
            "numpy_random": not np.array_equal(np.random.get_state(legacy=False)["state"]["key"], before[1]),
            "threads": threading.active_count() - before[2],
        }
        loaded: dict[str, Any] = {"effects": effects}
        if isinstance(self.target, targets.Source):
            loaded |= self._classes(self.target)
            self.channel.send_json(Kind.LOADED, loaded, flush=True)
            if "class" not in loaded:
                return
        self._describe_instance(loaded)
        modules = [name for name in sys.modules if name not in known]
        if isinstance(self.target, targets.Source):
            modules = [name for name in modules if name.partition(".")[0] not in sys.stdlib_module_names]
        loaded["modules"] = modules[:_MAX_MODULES]
        if not isinstance(self.target, targets.Source):
            loaded["effects"]["threads"] = threading.active_count() - before[2]
        self.channel.send_json(Kind.LOADED, loaded, flush=True)

    def _classes(self, target: targets.Source) -> dict[str, Any]:
        """The classes of a file, and the one to judge."""
        module = target.module
        assert module is not None
        names = concrete_classes(module)
        chosen = target.wanted or (names[0] if len(names) == 1 else None)
        described: dict[str, Any] = {
            "classes": [
                {"name": name, "line": _line(getattr(module, name)) or _bound_at(target.filename, name)}
                for name in names
            ],
            "lookalikes": targets.lookalikes(module),
            "wrappers": targets.wrappers(module),
            "unfinished": [
                {"name": kind.__name__, "line": _line(kind), "lacks": lacks, "abstract": abstract}
                for kind, (lacks, abstract) in (targets.unfinished(module) if not names else {}).items()
            ],
        }
        if chosen is not None and inspect.isclass(getattr(module, chosen, None)):
            described["class"] = chosen
        return described

    def _describe_instance(self, loaded: dict[str, Any]) -> None:
        """Add facts about the class and an instance to `loaded`; send what is known before a constructor may raise."""
        creator = self.creator()
        if not isinstance(self.target, targets.Registered):
            loaded["required"] = targets.required_arguments(creator, self.target.kwargs)
        if inspect.isclass(creator) and issubclass(creator, gymnasium.Wrapper):
            # Of a file that imports it, the wrapper that the target names.
            loaded["wrappers"] = [*loaded.get("wrappers", ()), loaded.get("class", creator.__qualname__)]
        if loaded.get("required") and inspect.isclass(creator) and not issubclass(creator, gymnasium.Env):
            loaded["made"], loaded["environment"] = f"{creator.__module__}.{creator.__qualname__}", False
            loaded["lookalikes"] = [loaded["made"]] if targets.looks_alike(creator) else []
        self._describe_class(loaded, creator)
        self.channel.send_json(Kind.LOADED, loaded, flush=True)
        if loaded.get("required"):
            return
        env = self.construct(resize=True)
        if not isinstance(self.target, targets.Source):
            loaded["made"], loaded["environment"] = type_name(env), isinstance(env, gymnasium.Env)
            if not loaded["environment"]:
                loaded["lookalikes"] = [loaded["made"]] if targets.looks_alike(env) else []
                self.channel.send_json(Kind.LOADED, loaded, flush=True)
                return
            self._describe_class(loaded, type(env.unwrapped))
        for name in ("observation_space", "action_space"):
            space = self.call("spaces", getattr, env, name, None)
            loaded[name] = describe_space(space) if isinstance(space, gymnasium.Space) else {"type": type_name(space)}
        loaded["reset"] = _reset_parameters(env)
        metadata = getattr(env, "metadata", None)
        modes = metadata.get("render_modes") if isinstance(metadata, dict) else None
        loaded["render_modes"] = [str(mode) for mode in modes] if isinstance(modes, list | tuple | set) else []
        loaded["renders"] = getattr(type(env.unwrapped), "render", None) is not gymnasium.Env.render
        loaded["rendering"] = _rendering(env, creator, self.target.kwargs)
        loaded["nondeterministic"] = bool(getattr(getattr(env, "spec", None), "nondeterministic", False))

    def _describe_class(self, loaded: dict[str, Any], kind: Any) -> None:
        if not inspect.isclass(kind):
            return
        loaded["line"], own = _line(kind), self._is_own(_file_of(kind))
        if isinstance(self.target, targets.Source) and (loaded["line"] is None or not own):
            # No statement defines a class that a call of `type` makes.
            loaded["line"] = _bound_at(self.target.filename, loaded["class"])
        if isinstance(self.target, targets.Source) and not own:
            loaded["elsewhere"] = _named(kind, _file_of(kind), _line(kind))
        loaded["lines"] = {
            name: _line(getattr(kind, name)) for name in _METHODS if name in dir(kind) and self._defines(kind, name)
        }
        loaded["inherited"] = {
            name: _inherited(owner, vars(owner)[name])
            for name in _METHODS
            if name not in loaded["lines"] and (owner := _owner(kind, name)) not in (None, kind, object)
        }
        if not isinstance(self.target, targets.Source):
            loaded["class"] = kind.__qualname__
            loaded["module"] = kind.__module__
            file = _source_file(kind)
            loaded["sha256"] = _digest_of(file)
            if file is not None:
                loaded["file"] = file[-_MAX_NAME:]

    def _defines(self, kind: type, name: str) -> bool:
        """Whether the file that findings name defines a method, not the file of a base class."""
        method = getattr(kind, name)
        if isinstance(self.target, targets.Source):
            code = _code(method)
            return code is not None and self._is_own(code.co_filename)
        return _source_file(method) == _source_file(kind)

    def _is_beside(self, frame: traceback.FrameSummary) -> bool:
        """Whether a frame is in a file of the target's project, or of the package of an installed class."""
        own = [self._folder, *([self._package] if self._package else [])]
        return frame.filename.startswith(tuple(f"{folder}{os.sep}" for folder in own))

    def _is_own(self, file: str) -> bool:
        """Whether a file is the target's, of which other files of the project may import a copy."""
        return os.path.join(self._folder, file) == os.path.join(self._folder, self.target.filename)

    def _report(self, phase: str, error: BaseException) -> dict[str, Any]:
        frames = traceback.extract_tb(error.__traceback__)
        # A policy may call the environment, whose lines are not its own.
        file = f"<{_POLICY}>" if phase == "policy" else self.target.filename
        own = [frame for frame in frames if frame.filename == file]
        line = own[-1].lineno if own else _line_of(error, file)
        last = next((frame for frame in reversed(frames) if frame.filename == file or self._is_beside(frame)), None)
        elsewhere = None if last is None or last.filename == file or self._is_own(last.filename) else last
        try:
            # Each worker may have its project in another folder.
            message = str(error).replace(f"{self._folder}{os.sep}", "")
        except BaseException:
            message = "(its message could not be read)"
        shown = [frame for frame in frames if not any(name in frame.filename for name in _OTHER_FRAMES)]
        # However deep a library's calls are, one frame is the project's.
        shown = [frame for frame in shown[:-_MOST_FRAMES] if frame is last] + shown[-_MOST_FRAMES:]
        for frame in shown:
            if frame.filename == self.target.filename:
                # Marks move the columns that a traceback underlines.
                frame.colno = self.target.column(frame.lineno, frame.colno)
                frame.end_colno = self.target.column(frame.end_lineno, frame.end_colno)
            frame.filename = frame.filename.removeprefix(f"{self._folder}{os.sep}")
        return {
            "phase": phase,
            "type": type_name(error),
            "message": message[:2000],
            "line": line,
            "memory": isinstance(error, MemoryError),
            "errno": error.errno if isinstance(error, OSError) else None,
            "traceback": "".join(traceback.format_list(shown))[-8000:],
            "module": getattr(error, "name", None) if isinstance(error, ImportError) else None,
            "file": None if elsewhere is None else elsewhere.filename,
            "file_line": None if elsewhere is None else elsewhere.lineno,
        }


def attributes(env: Any) -> dict[str, Any]:
    """A JSON image of an environment's own attributes, without its random generators."""
    return {
        name: jsonable(value)
        for name, value in vars(env.unwrapped).items()
        if not isinstance(value, np.random.Generator | np.random.RandomState | random.Random)
    }


def _rendering(env: Any, creator: Any, given: dict[str, Any]) -> dict[str, Any]:
    """What the constructor did with the render mode, and what the metadata says on how fast frames follow."""
    try:
        parameters = list(inspect.signature(creator).parameters.values())
    except (ValueError, TypeError):
        parameters = []
    metadata = getattr(env, "metadata", None)
    metadata = metadata if isinstance(metadata, dict) else {}
    kept = getattr(env.unwrapped, "render_mode", None)
    rate = metadata.get("render_fps")
    return {
        "takes": any(each.name == "render_mode" or each.kind is each.VAR_KEYWORD for each in parameters),
        "given": rendering(creator, given).get("render_mode"),
        "optional": all(each.default is None for each in parameters if each.name == "render_mode"),
        "kept": kept[:100] if isinstance(kept, str) else None if kept is None else type_name(kept),
        "rate": rate is not None,
        "fps": float(rate) if isinstance(rate, int | float) and 0 < rate <= _FASTEST else None,
        "old": [key for key in _OLD_KEYS if key in metadata],
    }


def _reset_parameters(env: Any) -> list[str]:
    """Which of the keywords ``seed`` and ``options`` reset() accepts."""
    try:
        parameters = inspect.signature(env.unwrapped.reset).parameters
    except (ValueError, TypeError, AttributeError):
        return ["seed", "options"]
    if inspect.Parameter.VAR_KEYWORD in [parameter.kind for parameter in parameters.values()]:
        return ["seed", "options"]
    return [name for name in ("seed", "options") if name in parameters]


def _line_of(error: BaseException, file: str) -> int | None:
    """The line of a syntax error in a file."""
    return error.lineno if isinstance(error, SyntaxError) and error.filename == file else None


def _line(value: Any) -> int | None:
    """The first line of a class or function, decorators included."""
    if inspect.isclass(value):
        found = definitions(_file_of(value))
        named = [line for line, node in found.items() if isinstance(node, ast.ClassDef) and node.name == value.__name__]
        return named[-1] if named else None
    code = _code(value)
    return code.co_firstlineno if code is not None else None


def _file_of(kind: type) -> str:
    """The file of the module that defines a class, "" if it is not known."""
    return getattr(sys.modules.get(kind.__module__), "__file__", None) or ""


def _bound_at(filename: str, name: str) -> int | None:
    """The last line at which a file binds a name when it is imported; None if no statement shows it."""
    try:
        tree = ast.parse("".join(linecache.getlines(filename)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    bound, starred = [], []
    for node in _executed(tree):
        if isinstance(node, ast.alias):
            if node.name == "*":
                starred.append(node.lineno)
            elif name == (node.asname or node.name.partition(".")[0]):
                bound.append(node.lineno)
        elif isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            bound += [node.lineno] if node.name == name else []
        elif isinstance(node, ast.Name) and node.id == name and isinstance(node.ctx, ast.Store):
            bound.append(node.lineno)
    return next(iter([*bound[-1:], *starred[-1:]]), None)


def _executed(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes below one that run when a module is imported, without those in classes and functions."""
    for child in ast.iter_child_nodes(node):
        yield child
        if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from _executed(child)


def _owner(kind: type, name: str) -> type | None:
    """The class that a class has a method from."""
    return next((each for each in kind.__mro__ if name in vars(each)), None)


def _inherited(owner: type, function: Any) -> str:
    """The class that has a function, with the function's place."""
    code = _code(function)
    return _named(owner, "", None) if code is None else _named(owner, code.co_filename, code.co_firstlineno)


def _named(kind: type, file: str, line: int | None) -> str:
    """The full name of a class, with a file and line in parentheses if they are known."""
    place = "" if line is None else f" ({os.path.basename(file)}:{line})"
    return f"{kind.__module__}.{kind.__qualname__}{place}"[:_MAX_NAME]


def _code(function: Any) -> CodeType | None:
    try:
        code = getattr(inspect.unwrap(function), "__code__", None)
    except ValueError:
        return None
    return code if isinstance(code, CodeType) else None


def _source_file(value: Any) -> str | None:
    try:
        return inspect.getsourcefile(value)
    except (OSError, TypeError):
        return None


def _digest_of(path: str | None) -> str | None:
    if path is None:
        return None
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
