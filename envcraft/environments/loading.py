"""Import the source of a trusted environment into this process and construct the environment."""

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
    """Loads the bytes whose digest was checked. It does not read the file, and it neither reads nor writes caches."""

    def __init__(self, path: str, source: bytes) -> None:
        self._path, self._source = path, source

    def get_filename(self, fullname: str) -> str:
        return self._path

    def get_data(self, path: str) -> bytes:
        return self._source


def load(path: str, source: bytes, sha256: str) -> ModuleType:
    """Import a source under a unique module name. A process imports each source once.

    Args:
        path: the file of the source, for tracebacks.
        source: the Python file.
        sha256: the expected digest of `source`.

    Raises:
        UsageError: `source` has another digest.
        Exception: whatever the module raises.
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
    """Construct an instance as the worker does.

    The constructor receives ``render_mode="rgb_array"`` if it takes that argument and `kwargs` does not have it. The
    contract's adapter wraps the instance.

    Args:
        name: names the environment in messages.
        module: contains the class.
        env_class: the class's name; None if there is only one.
        adapter: of the contract, as data.
        kwargs: the arguments of the constructor.

    Raises:
        UsageError: there is no such class.
        EnvironmentFailed: the constructor raises, or returns no ``gymnasium.Env``.
    """
    names = [env_class] if env_class else concrete_classes(module)
    if len(names) != 1 or not hasattr(module, names[0]):
        what = f"has the environment classes {', '.join(names)}" if len(names) > 1 else "has no environment class"
        raise UsageError(f"{name} {what}; run `envcraft validate {module.__file__}` for details")
    creator = getattr(module, names[0])
    try:
        env = creator(**kwargs | rendering(creator, kwargs))
    except Exception as error:
        raise EnvironmentFailed(f"{name} cannot be constructed: {type(error).__name__}: {error}") from error
    if not isinstance(env, gymnasium.Env):
        raise EnvironmentFailed(f"{name}: {names[0]} constructs {type(env).__name__}, not gymnasium.Env")
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
    """Import a source and construct an instance; for the arguments see :func:`load` and :func:`construct`.

    Raises:
        UsageError: the digest is wrong, or there is no such class.
        EnvironmentFailed: the module or the constructor raises.
    """
    try:
        module = load(path, source, sha256)
    except UsageError:
        raise
    except Exception as error:
        raise EnvironmentFailed(f"{name} cannot be imported: {type(error).__name__}: {error}") from error
    return construct(name, module, env_class, adapter, kwargs)
