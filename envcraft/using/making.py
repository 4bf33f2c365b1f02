"""``envcraft.make``: one environment, in this process once it is trusted, else in a sandbox."""

from __future__ import annotations

import os
from typing import Any

import gymnasium

from envcraft.using.loading import open_trusted
from envcraft.using.sources import Found, locate


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

    It is adapted to its contract exactly as it was when it was judged. `kwargs` go to its constructor.

    Args:
        target: a corpus, a folder that was audited, or a Python file.
        name: which environment of a corpus; ``.py`` at its end may be left out.
        contract: what it promises; by default the contract that it has passed, else ``arcade``.
        trust: run the code in this process though no verdict says that it passes.
        sandbox: run the code there instead, trusted or not: ``auto``, ``docker``, ``bubblewrap`` or ``process``.
        runtime: the container runtime of the docker sandbox.

    Raises:
        Untrusted: the code has not passed, and neither `trust` nor `sandbox` is given.
        UsageError: there is no such environment, contract or sandbox.
        EnvironmentFailed: the file cannot be imported, or its class makes no environment.
    """
    return open_found(locate(target, name, contract), trust, sandbox, runtime, kwargs)


def open_found(
    found: Found, trust: bool, sandbox: str | None, runtime: str | None, kwargs: dict[str, Any]
) -> gymnasium.Env[Any, Any]:
    """What :func:`make` does with an environment that was found."""
    if sandbox is not None:
        from envcraft.using.sandboxed import open_sandboxed

        return open_sandboxed(found.name, found.source, found.env_class, found.contract, sandbox, runtime, kwargs)
    if not trust:
        found.ensure_trusted()
    adapter = found.contract.adapter
    return open_trusted(found.name, found.path, found.source, found.sha256, found.env_class, adapter, kwargs)
