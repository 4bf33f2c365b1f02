"""Load the code under test and call it, so that whatever it does ends as a report and not as an unwound worker."""

from __future__ import annotations

import ast
import inspect
import linecache
import random
import sys
import threading
import time
import traceback
from collections.abc import Callable
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np

from envcraft_sandbox.wire import Kind

from . import adapters, spaces
from .channel import Channel, jsonable, type_name

_MODULE = "envcraft_subject"
_POLICY = "envcraft_policy"
_monotonic = time.monotonic


class Fault(Exception):
    """The subject failed in a call; `report` says how."""

    def __init__(self, report: dict[str, Any]) -> None:
        super().__init__(report.get("message", ""))
        self.report = report


class Subject:
    """The module, its class and the calls that are made on its instances."""

    def __init__(self, job: dict[str, Any], channel: Channel) -> None:
        self.channel = channel
        self.filename: str = job["filename"]
        self.contract: dict[str, Any] = job["contract"]
        self.action_spec: dict[str, Any] | None = self.contract.get("action")
        self._source: str = job["source"]
        self._wanted: str | None = job.get("class")
        self._module: ModuleType | None = None
        self._class: Any = None

    def call(self, phase: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call untrusted code. Any exception, SystemExit too, becomes a :class:`Fault` of `phase`."""
        try:
            return function(*args, **kwargs)
        except BaseException as error:
            raise Fault(self._report(phase, error)) from None

    def load(self) -> ModuleType:
        """Execute the file as a module."""
        if self._module is None:
            self.channel.phase("import")
            self._module = self._execute(_MODULE, self._source, self.filename, "import")
        return self._module

    def environment_class(self) -> Any:
        if self._class is None:
            module = self.load()
            names = concrete_classes(module)
            name = self._wanted or (names[0] if len(names) == 1 else None)
            if name is None or not hasattr(module, name):
                raise Fault(
                    {"phase": "import", "type": "LookupError", "message": f"{len(names)} classes", "line": None}
                )
            self._class = getattr(module, name)
        return self._class

    def construct(self, announce: bool = True) -> Any:
        """Make an instance, adapted to the contract, with ``render_mode="rgb_array"`` where the constructor takes
        that.
        """
        kind = self.environment_class()
        if announce:
            self.channel.phase("construct")
        kwargs = {"render_mode": "rgb_array"} if _takes_render_mode(kind) else {}
        env = self.call("construct", kind, **kwargs)
        return adapters.apply(env, self.contract.get("adapter") or {})

    def action(self, value: Any, env: Any) -> Any:
        spec = self.action_spec
        if spec is None:
            spec = self.action_spec = spaces.describe(env.action_space)
        return spaces.action(spec, value)

    def load_policy(self, policy: dict[str, Any]) -> ModuleType:
        self.channel.phase("policy")
        return self._execute(_POLICY, policy["source"], policy["filename"], "policy", {"np": np})

    def describe(self) -> None:
        """Send what the file defines: its classes, the spaces of an instance, and what importing it changed."""
        before = (random.getstate(), np.random.get_state(legacy=False)["state"]["key"].copy(), threading.active_count())
        started = _monotonic()
        module = self.load()
        seconds = _monotonic() - started
        effects = {
            "seconds": seconds,
            "random": random.getstate() != before[0],
            "numpy_random": not np.array_equal(np.random.get_state(legacy=False)["state"]["key"], before[1]),
            "threads": threading.active_count() - before[2],
        }
        names = concrete_classes(module)
        loaded: dict[str, Any] = {
            "classes": [{"name": name, "line": _line(getattr(module, name))} for name in names],
            "lookalikes": lookalikes(module),
            "effects": effects,
        }
        chosen = self._wanted or (names[0] if len(names) == 1 else None)
        self.channel.send_json(Kind.LOADED, loaded, flush=True)
        if chosen is None or not inspect.isclass(getattr(module, chosen, None)):
            return
        kind = getattr(module, chosen)
        loaded["class"] = chosen
        loaded["line"] = _line(kind)
        loaded["required"] = required_arguments(kind)
        loaded["lines"] = {
            name: _line(getattr(kind, name))
            for name in ("__init__", "reset", "step", "render", "close")
            if name in dir(kind)
        }
        if loaded["required"]:
            self.channel.send_json(Kind.LOADED, loaded, flush=True)
            return
        env = self.construct()
        for name in ("observation_space", "action_space"):
            space = getattr(env, name, None)
            loaded[name] = spaces.describe(space) if isinstance(space, gymnasium.Space) else {"type": type_name(space)}
        loaded["reset"] = _reset_parameters(env)
        metadata = getattr(env, "metadata", None)
        modes = metadata.get("render_modes") if isinstance(metadata, dict) else None
        loaded["render_modes"] = [str(mode) for mode in modes] if isinstance(modes, list | tuple | set) else []
        self.channel.send_json(Kind.LOADED, loaded, flush=True)

    def _execute(
        self, name: str, source: str, filename: str, phase: str, extra: dict[str, Any] | None = None
    ) -> ModuleType:
        module = ModuleType(name)
        module.__file__ = filename
        module.__dict__.update(extra or {})
        sys.modules[name] = module
        linecache.cache[filename] = (len(source), None, source.splitlines(keepends=True), filename)
        code = self.call(phase, compile, source, filename, "exec")
        self.call(phase, exec, code, module.__dict__)
        return module

    def _report(self, phase: str, error: BaseException) -> dict[str, Any]:
        frames = traceback.extract_tb(error.__traceback__)
        own = [frame for frame in frames if frame.filename in (self.filename, f"<{_POLICY}>")]
        line = own[-1].lineno if own else getattr(error, "lineno", None) if isinstance(error, SyntaxError) else None
        try:
            message = str(error)
        except BaseException:
            message = "(its message could not be read)"
        shown = [frame for frame in frames if "envcraft_sandbox" not in frame.filename][-8:]
        return {
            "phase": phase,
            "type": type_name(error),
            "message": message[:2000],
            "line": line,
            "memory": isinstance(error, MemoryError),
            "traceback": "".join(traceback.format_list(shown))[-8000:],
            "name": getattr(error, "name", None) if isinstance(error, ImportError) else None,
        }


def concrete_classes(module: ModuleType) -> list[str]:
    """Name the environment classes that the module defines and that can be instantiated.

    Left out are abstract bases (abstract methods, or ``step``/``reset`` that are missing or only raise), wrappers, and
    private classes (``_Base``) while there is a public one.
    """
    found = [
        name
        for name, value in list(vars(module).items())
        if inspect.isclass(value)
        and value.__module__ == module.__name__
        and value.__name__ == name
        and issubclass(value, gymnasium.Env)
        and not issubclass(value, gymnasium.Wrapper)
        and not inspect.isabstract(value)
        and all(_implemented(value, method) for method in ("reset", "step"))
    ]
    return [name for name in found if not name.startswith("_")] or found


def lookalikes(module: ModuleType) -> list[str]:
    """Name the classes that have ``reset`` and ``step`` and are no environment."""
    return [
        name
        for name, value in list(vars(module).items())
        if inspect.isclass(value)
        and value.__module__ == module.__name__
        and not issubclass(value, gymnasium.Env)
        and callable(getattr(value, "reset", None))
        and callable(getattr(value, "step", None))
    ]


def required_arguments(kind: type) -> list[str]:
    try:
        parameters = inspect.signature(kind).parameters.values()
    except (ValueError, TypeError):
        return []
    return [
        parameter.name
        for parameter in parameters
        if parameter.default is parameter.empty
        and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
    ]


def attributes(env: Any) -> dict[str, Any]:
    """A JSON image of an environment's own attributes, its random generators left out."""
    return {
        name: jsonable(value)
        for name, value in vars(env.unwrapped).items()
        if not isinstance(value, np.random.Generator | np.random.RandomState | random.Random)
    }


def _implemented(kind: type, method: str) -> bool:
    function = getattr(kind, method, None)
    if function is None or function is getattr(gymnasium.Env, method):
        return False
    try:
        import textwrap

        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    except (OSError, TypeError, SyntaxError, IndexError):
        return True
    if not isinstance(tree, ast.FunctionDef):
        return True
    body = [
        node
        for node in tree.body
        if not (isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)))
    ]
    return not all(isinstance(node, ast.Raise) and "NotImplementedError" in ast.dump(node) for node in body)


def _takes_render_mode(kind: type) -> bool:
    try:
        parameters = inspect.signature(kind).parameters
    except (ValueError, TypeError):
        return False
    return "render_mode" in parameters


def _reset_parameters(env: Any) -> list[str]:
    """Which of ``seed`` and ``options`` reset() takes as keywords."""
    try:
        parameters = inspect.signature(env.unwrapped.reset).parameters
    except (ValueError, TypeError, AttributeError):
        return ["seed", "options"]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
        return ["seed", "options"]
    return [name for name in ("seed", "options") if name in parameters]


def _line(value: Any) -> int | None:
    try:
        return inspect.getsourcelines(value)[1]
    except (OSError, TypeError, IndexError):
        return None
