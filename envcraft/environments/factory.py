"""``envcraft.make``: one environment, in this process if it is trusted, else in a sandbox."""

from __future__ import annotations

import os
from typing import Any

import gymnasium

from envcraft.environments.loading import open_trusted
from envcraft.environments.sources import EnvSource, resolve


def make(
    target: str | os.PathLike[str],
    name: str | None = None,
    *,
    contract: str | None = None,
    trust: bool = False,
    sandbox: str | None = None,
    runtime: str | None = None,
    **kwargs: Any,
) -> gymnasium.Env[Any, Any]:
    """Make the environment `name` of the corpus `target`, or the one in the file `target`.

    The environment is adapted to its contract in the same way as when it was judged.

    Args:
        target: A corpus, a folder that was audited, or a Python file.
        name: An environment of the corpus; the ``.py`` at its end is optional.
        contract: The contract; by default the one under which the environment has passed, else ``arcade``.
        trust: Run the code in this process although no verdict says that it passes.
        sandbox: Run the code in this sandbox, trusted or not: ``auto``, ``docker``, ``bubblewrap`` or ``process``.
        runtime: The container runtime of the docker sandbox.
        kwargs: Arguments for the constructor.

    Returns:
        The environment.

    Raises:
        Untrusted: The code has not passed, and neither `trust` nor `sandbox` is given.
        UsageError: There is no such environment, contract or sandbox.
        EnvironmentFailed: The file cannot be imported, or its class cannot be constructed.
    """
    return open_env(resolve(target, name, contract), trust, sandbox, runtime, kwargs)


def open_env(
    source: EnvSource, trust: bool, sandbox: str | None, runtime: str | None, kwargs: dict[str, Any]
) -> gymnasium.Env[Any, Any]:
    """Make an environment of a resolved source; arguments and errors are those of :func:`make`."""
    if sandbox is not None:
        from envcraft.environments.sandboxed import open_sandboxed

        where = (sandbox, runtime, kwargs, source.project)
        return open_sandboxed(source.name, source.source, source.env_class, source.contract, *where)
    if not trust:
        source.ensure_trusted()
    adapter = source.contract.adapter
    return open_trusted(source.name, source.path, source.source, source.sha256, source.env_class, adapter, kwargs)
