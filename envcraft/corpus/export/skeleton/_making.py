"""Register the environments of ``environments.json`` with Gymnasium, and construct them as they were validated."""

from __future__ import annotations

import importlib
import importlib.resources
import json
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec

from ._runtime import adapters
from ._runtime.classes import concrete_classes, rendering

_PACKAGE = __name__.rpartition(".")[0]

#: The record of each environment by its id.
ENVIRONMENTS: dict[str, dict[str, Any]] = {
    record["id"]: record
    for record in json.loads(importlib.resources.files(_PACKAGE).joinpath("environments.json").read_text("utf-8"))[
        "environments"
    ]
}


def register() -> None:
    """Register every environment with Gymnasium."""
    # gymnasium.register() compares each new id with all others, which is slow for many.
    gymnasium.registry.update({name: _spec(name) for name in ENVIRONMENTS})


def _spec(name: str) -> EnvSpec:
    return EnvSpec(name, f"{__name__}:create", disable_env_checker=True, kwargs={"environment": name})


def create(environment: str, **kwargs: Any) -> gymnasium.Env[Any, Any]:
    """Construct an environment under its contract's adapter.

    Args:
        environment: its id.
        kwargs: the arguments of its constructor.
    """
    record = ENVIRONMENTS[environment]
    module = importlib.import_module(f"{_PACKAGE}.sources.{record['module']}")
    creator = getattr(module, record["class"] or concrete_classes(module)[0])
    made: gymnasium.Env[Any, Any] = adapters.apply(creator(**kwargs | rendering(creator, kwargs)), record["adapter"])
    return made
