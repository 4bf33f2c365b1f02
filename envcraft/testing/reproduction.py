"""Episodes as commands: what Hypothesis has shortened becomes a reproduction that EnvCraft plays in a sandbox."""

from __future__ import annotations

import inspect
import shlex
import sys
from collections.abc import Sequence
from typing import Any

import gymnasium
import hypothesis
import msgspec

from envcraft.model.rollout import Conditions
from envcraft.model.verdict import Repro
from envcraft.text import relative


def note_episode(
    env: gymnasium.Env[Any, Any],
    seed: int,
    actions: Sequence[Any],
    conditions: Conditions = Conditions(),
    contract: str = "gymnasium",
) -> None:
    """Let Hypothesis print the command that plays an episode, if the running test fails."""
    if hypothesis.currently_in_test_context():
        hypothesis.note(f"To play this episode in EnvCraft:\n  {command(env, seed, actions, conditions, contract)}")


def command(
    env: gymnasium.Env[Any, Any], seed: int, actions: Sequence[Any], conditions: Conditions, contract: str
) -> str:
    """The command that plays an episode of the class of an environment in a sandbox."""
    repro = msgspec.json.encode(Repro(seed, list(actions), dict(conditions.to_json()))).decode()
    target = _target(type(env.unwrapped))
    return shlex.join(["envcraft", "replay", *target, "--contract", contract, "--repro", repro])


def _target(kind: type) -> list[str]:
    """A class as a TARGET of the command line: a module's if the module is in a package, else its file."""
    module = sys.modules.get(kind.__module__)
    if getattr(module, "__package__", ""):
        return [f"{kind.__module__}:{kind.__qualname__}"]
    try:
        file = inspect.getsourcefile(kind)
    except (OSError, TypeError):
        file = None
    return [relative(file) if file else f"{kind.__module__}.py", "--class", kind.__qualname__]
