"""Gymnasium ids for the environments of a corpus: ``EnvCraft/<name>-v0``, registered without importing any of them.

A name without its ``.py`` is its own id as far as Gymnasium allows: letters, digits, ``_``, ``-``, and single dots
between those. A slash becomes two dots, anything else its code point in hexadecimal between ``..x`` and ``..``, and
a name that did not end in ``.py`` gets ``..x..`` at its end. No two names have the same id.
"""

from __future__ import annotations

import os
import re
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec

from envcraft.errors import UsageError
from envcraft.using.making import make
from envcraft.using.sources import VARIABLE, default_corpus, names, needed_corpus

NAMESPACE = "EnvCraft"
_ENTRY = f"{__name__}:create"
#: What is written otherwise: a dot at an end or beside another sign, and any other sign.
_ODD = re.compile(r"(?<![\w-])\.|\.(?![\w-])|[^\w.-]")
_NAMESPACE = re.compile(r"[\w-]+")


def identifier(name: str, namespace: str = NAMESPACE) -> str:
    """The id of the environment `name`."""
    stem = name.removesuffix(".py")
    return f"{namespace}/{_ODD.sub(_written, stem)}{'' if stem != name else '..x..'}-v0"


def _written(odd: re.Match[str]) -> str:
    # With an x after it, two dots would read as the beginning of a code point.
    slash = odd[0] == "/" and odd.string[odd.end() : odd.end() + 1] != "x"
    return ".." if slash else f"..x{ord(odd[0]):x}.."


def register(corpus: str | os.PathLike[str] | None = None, namespace: str = NAMESPACE) -> list[str]:
    """Register every environment of a corpus with Gymnasium, whatever was judged of it; give the ids.

    None is imported, and what may run is decided when one is made. Without `corpus` it is the one that ENVCRAFT_CORPUS
    names, or ``corpus`` in ``[tool.envcraft]``.

    Raises UsageError where there is no corpus, or another one is registered under the namespace.
    """
    if not _NAMESPACE.fullmatch(namespace):
        raise UsageError(f"{namespace!r} is no namespace: letters, digits, _ and - make one")
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
    return EnvSpec(name, _ENTRY, disable_env_checker=True, kwargs={"target": target, "name": environment})


def create(**kwargs: Any) -> gymnasium.Env[Any, Any]:
    """The entry point of every id: what was registered, and what ``gymnasium.make`` is given, for ``envcraft.make``.

    Data sets name no corpus: theirs is the one that ENVCRAFT_CORPUS or ``pyproject.toml`` names. Raises UsageError.
    """
    if "target" not in kwargs and (corpus := default_corpus()) is not None:
        kwargs["target"] = corpus
    if "target" not in kwargs:
        raise UsageError(f"no corpus is named that has {kwargs.get('name')}: set {VARIABLE}")
    return make(**kwargs)
