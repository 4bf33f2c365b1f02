"""From ``environments.json`` to Gymnasium's registry, and from an id to an environment as it was validated."""

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

#: What is known of each environment, by its id.
ENVIRONMENTS: dict[str, dict[str, Any]] = {
    told["id"]: told
    for told in json.loads(importlib.resources.files(_PACKAGE).joinpath("environments.json").read_text("utf-8"))[
        "environments"
    ]
}


def register() -> None:
    """Register every environment with Gymnasium."""
    # gymnasium.register() looks through all ids for each new one.
    gymnasium.registry.update({name: _spec(name) for name in ENVIRONMENTS})


def _spec(name: str) -> EnvSpec:
    return EnvSpec(name, f"{__name__}:create", disable_env_checker=True, kwargs={"environment": name})


def create(environment: str, **kwargs: Any) -> gymnasium.Env[Any, Any]:
    """Make the environment with this id, adapted to its contract; `kwargs` go to its constructor."""
    told = ENVIRONMENTS[environment]
    module = importlib.import_module(f"{_PACKAGE}.sources.{told['module']}")
    creator = getattr(module, told["class"] or concrete_classes(module)[0])
    made: gymnasium.Env[Any, Any] = adapters.apply(creator(**kwargs | rendering(creator, kwargs)), told["adapter"])
    return made
