"""A privileged policy that runs with the environment: a class with ``act(state)``, or a function ``policy(env)``."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
from envcraft_protocol import jobs
from envcraft_protocol.classes import type_name

from .channel import jsonable
from .subject import Fault, Subject, attributes

_NONE = object()


class ReadOnlyState(AttributeError):
    """A policy tried to set an attribute of the environment."""


class State:
    """Read-only access to the environment's attributes: ``state.player_x`` or ``state["player_x"]``.

    ``get`` and ``keys`` work as in a mapping, unless the environment has attributes of these names. Objects behind the
    attributes belong to the environment. The host detects a policy that changes one: it repeats the policy's actions
    without it.
    """

    __slots__ = ("_env",)

    def __init__(self, env: Any) -> None:
        object.__setattr__(self, "_env", env)

    def __getattribute__(self, name: str) -> Any:
        own = object.__getattribute__
        if name == "__dict__":
            return dict(vars(own(self, "_env")))
        if name.startswith("__"):
            return own(self, name)
        try:
            return getattr(own(self, "_env"), name)
        except AttributeError:
            if name in ("get", "keys"):
                return own(self, name)
            raise

    def __getitem__(self, name: str) -> Any:
        try:
            return getattr(self, name)
        except AttributeError:
            raise KeyError(name) from None

    def get(self, name: str, default: Any = None) -> Any:
        return getattr(self, name, default)

    def keys(self) -> list[str]:
        return list(vars(object.__getattribute__(self, "_env")))

    def __setattr__(self, name: str, value: Any) -> None:
        raise ReadOnlyState(f"the state is read-only: {name} cannot be set")

    def __delattr__(self, name: str) -> None:
        raise ReadOnlyState(f"the state is read-only: {name} cannot be deleted")


class Policy:
    """The policy of a file, which chooses actions for `env`."""

    def __init__(self, subject: Subject, policy: jobs.Policy, env: Any) -> None:
        module = subject.load_policy(policy)
        self._subject = subject
        self._env = env
        players = [
            value
            for value in vars(module).values()
            if inspect.isclass(value) and value.__module__ == module.__name__ and callable(getattr(value, "act", None))
        ]
        function = getattr(module, "policy", None)
        if players:
            player = subject.call("policy", players[-1])
            self._function, self._argument = player.act, State(env.unwrapped)
        elif inspect.isfunction(function):
            self._function, self._argument = function, env.unwrapped
        else:
            raise Fault(
                {
                    "phase": "policy",
                    "type": "LookupError",
                    "message": "no class with act(state) and no function policy(env)",
                    "line": None,
                }
            )

    def choose(self) -> Any:
        """The policy's action as JSON. Raises Fault, also if the call changes the environment's attributes."""
        before = attributes(self._env)
        value = self._subject.call("policy", self._function, self._argument)
        after = attributes(self._env)
        changed = sorted(name for name in {*before, *after} if before.get(name, _NONE) != after.get(name, _NONE))
        if changed:
            raise Fault({"phase": "policy write", "message": f"it changes {', '.join(changed)}", "line": None})
        if not isinstance(value, int | np.integer | np.ndarray | list | tuple):
            raise Fault(
                {"phase": "policy", "type": "TypeError", "message": f"act returned {type_name(value)}", "line": None}
            )
        return jsonable(np.asarray(value).tolist())
