"""Registration of a corpus's environments with Gymnasium, without importing any of them."""

from __future__ import annotations

import os
import re
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec

from envcraft.corpus.ids import NAMESPACE, identifier
from envcraft.environments.factory import make
from envcraft.environments.sources import VARIABLE, default_corpus, names, needed_corpus
from envcraft.errors import UsageError

#: Where Gymnasium finds :func:`create`. Files name it too, so it must not change.
ENTRY_POINT = "envcraft:create"
_NAMESPACE = re.compile(r"[\w-]+")


def register(corpus: str | os.PathLike[str] | None = None, namespace: str = NAMESPACE) -> list[str]:
    """Register every environment of a corpus with Gymnasium, independent of its verdict.

    No environment is imported. Whether its code may run is decided when it is made.

    Args:
        corpus: The corpus; by default the one that ENVCRAFT_CORPUS or ``corpus`` in ``[tool.envcraft]`` names.
        namespace: The part of the ids before the slash.

    Returns:
        The ids, in the order of the names.

    Raises:
        UsageError: There is no corpus, or another one is registered under the namespace.
    """
    if not _NAMESPACE.fullmatch(namespace):
        raise UsageError(f"{namespace!r} is not a namespace: it must consist of letters, digits, _ and -")
    root = str(needed_corpus(corpus))
    specs = [_spec(identifier(name, namespace), root, name) for name in names(root)]
    for spec in specs:
        known = gymnasium.registry.get(spec.id)
        if known is not None and known.kwargs.get("target") != root:
            raise UsageError(
                f"the id {spec.id} is taken by {known.kwargs.get('target', known.entry_point)}; register {root} with "
                "another namespace"
            )
    # gymnasium.register() looks through all ids for each new one.
    gymnasium.registry.update({spec.id: spec for spec in specs})
    return [spec.id for spec in specs]


def _spec(name: str, target: str, environment: str) -> EnvSpec:
    return EnvSpec(name, ENTRY_POINT, disable_env_checker=True, kwargs={"target": target, "name": environment})


def create(**kwargs: Any) -> gymnasium.Env[Any, Any]:
    """Make a registered environment: the entry point of every id, and of exported data sets.

    Args:
        kwargs: Arguments for :func:`envcraft.make`. Without `target`, as in data sets, it is the corpus that
            ENVCRAFT_CORPUS or ``corpus`` in ``[tool.envcraft]`` names.

    Returns:
        The environment.

    Raises:
        UsageError: No corpus is named.
    """
    if "target" not in kwargs and (corpus := default_corpus()) is not None:
        kwargs["target"] = corpus
    if "target" not in kwargs:
        raise UsageError(f"the corpus of {kwargs.get('name')} is not known, because no corpus is named: set {VARIABLE}")
    return make(**kwargs)
