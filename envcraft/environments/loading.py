"""Import the source of a trusted environment into this process, and make the environment of it."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import threading
from importlib.abc import SourceLoader
from types import ModuleType
from typing import Any

import gymnasium
from envcraft_protocol import adapters
from envcraft_protocol.classes import concrete_classes, rendering

from envcraft.errors import EnvironmentFailed, UsageError

_PREFIX = "envcraft_source_"
_importing = threading.RLock()


class _Checked(SourceLoader):
    """Load the bytes whose digest was checked, not the file, and neither read nor write caches."""

    def __init__(self, path: str, source: bytes) -> None:
        self._path, self._source = path, source

    def get_filename(self, fullname: str) -> str:
        return self._path

    def get_data(self, path: str) -> bytes:
        return self._source


def load(path: str, source: bytes, sha256: str) -> ModuleType:
    """Import a source under a name of its own, once a process.

    Raises UsageError if `source` has another digest, and any exception of the module.
    """
    if hashlib.sha256(source).hexdigest() != sha256:
        raise UsageError(f"{path} has changed since it was looked up: its SHA-256 is no longer {sha256}")
    name = _PREFIX + sha256
    with _importing:
        if name not in sys.modules:
            loader = _Checked(path, source)
            spec = importlib.util.spec_from_loader(name, loader, origin=path)
            assert spec is not None
            spec.has_location = True
            module = importlib.util.module_from_spec(spec)
            sys.modules[name] = module
            try:
                loader.exec_module(module)
            except BaseException:
                del sys.modules[name]
                raise
        return sys.modules[name]


def construct(
    name: str, module: ModuleType, env_class: str | None, adapter: dict[str, Any], kwargs: dict[str, Any]
) -> gymnasium.Env[Any, Any]:
    """An instance as the worker makes it: with ``render_mode="rgb_array"`` where the class takes that and `kwargs` have
    no other, and under the contract's adapter.

    Raises UsageError where there is no such class, EnvironmentFailed where it makes no environment.
    """
    names = [env_class] if env_class else concrete_classes(module)
    if len(names) != 1 or not hasattr(module, names[0]):
        found = f"has the environment classes {', '.join(names)}" if len(names) > 1 else "has no environment class"
        raise UsageError(f"{name} {found}; `envcraft validate {module.__file__}` tells more")
    creator = getattr(module, names[0])
    try:
        env = creator(**kwargs | rendering(creator, kwargs))
    except Exception as error:
        raise EnvironmentFailed(f"{name} cannot be constructed: {type(error).__name__}: {error}") from error
    if not isinstance(env, gymnasium.Env):
        raise EnvironmentFailed(f"{name}: {names[0]} makes {type(env).__name__}, no gymnasium.Env")
    adapted: gymnasium.Env[Any, Any] = adapters.apply(env, adapter)
    return adapted


def open_trusted(
    name: str,
    path: str,
    source: bytes,
    sha256: str,
    env_class: str | None,
    adapter: dict[str, Any],
    kwargs: dict[str, Any],
) -> gymnasium.Env[Any, Any]:
    """Import and construct. Raises UsageError, EnvironmentFailed."""
    try:
        module = load(path, source, sha256)
    except UsageError:
        raise
    except Exception as error:
        raise EnvironmentFailed(f"{name} cannot be imported: {type(error).__name__}: {error}") from error
    return construct(name, module, env_class, adapter, kwargs)
