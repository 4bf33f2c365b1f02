"""Pass actions to step() as callers do that do not make a new array of the space's own type for each step."""

from __future__ import annotations

from typing import Any

import numpy as np
from envcraft_protocol.jobs import Conditions
from envcraft_protocol.spaces import Form

from .subject import Subject


class Caller:
    """Makes the values that are passed to step().

    Several forms of actions take turns. A form that the action space does not contain is left out.

    Args:
        subject: decodes the actions.
        env: the instance that is stepped.
        conditions: `int32` and `python` choose the forms, `reuse` overwrites the same arrays and lists for each step.
    """

    def __init__(self, subject: Subject, env: Any, conditions: Conditions) -> None:
        self._subject = subject
        self._env = env
        chosen: dict[Form, bool] = {"int32": bool(conditions.get("int32")), "python": bool(conditions.get("python"))}
        self._forms: list[Form] = [form for form, wanted in chosen.items() if wanted]
        self._reuse = bool(conditions.get("reuse"))
        self._passed: dict[Form, Any] = {}
        self._number = -1

    def action(self, chosen: Any) -> Any:
        """The value of an action that is given as JSON."""
        if self._number < 0:
            self._forms = [form for form in self._forms if self._is_allowed(chosen, form)] or ["own"]
        self._number += 1
        form = self._forms[self._number % len(self._forms)]
        if not self._reuse:
            return self._subject.action(chosen, self._env, form)
        # An environment may have kept any of them.
        for each in self._forms:
            value = self._subject.action(chosen, self._env, each)
            self._passed[each] = _overwritten(self._passed[each], value) if each in self._passed else value
        return self._passed[form]

    def _is_allowed(self, chosen: Any, form: Form) -> bool:
        value = self._subject.action(chosen, self._env, form)
        return bool(self._subject.call("spaces", lambda: self._env.action_space.contains(value)))


def _overwritten(old: Any, new: Any) -> Any:
    """The old value with the contents of the new one, or the new one if it cannot be overwritten."""
    if isinstance(new, np.ndarray) and isinstance(old, np.ndarray) and old.shape == new.shape:
        old[...] = new
        return old
    if isinstance(new, list) and isinstance(old, list):
        old[:] = new
        return old
    if isinstance(new, dict) and isinstance(old, dict):
        for name, value in new.items():
            old[name] = _overwritten(old.get(name), value)
        return old
    if isinstance(new, tuple) and type(new) is type(old) is tuple and len(new) == len(old):
        return tuple(map(_overwritten, old, new))
    return new
