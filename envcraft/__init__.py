"""EnvCraft: validation-first tools for generated Gymnasium environments.

The public Python API: what users of environments call, and what plugins subclass. Importing the package costs nothing,
because each name is imported when it is used.
"""

from __future__ import annotations

from envcraft.version import __version__

# Importing typing takes time in which Ctrl-C is a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from envcraft.api.validation import CheckFailed, check_env, validate
    from envcraft.corpus.executors import ExecutorPlugin
    from envcraft.corpus.export.exporter import Exporter
    from envcraft.demonstrations.player import Player
    from envcraft.environments.factory import make
    from envcraft.environments.families import Family, Generated
    from envcraft.environments.registration import create, register
    from envcraft.environments.sources import names
    from envcraft.environments.vector import make_vec
    from envcraft.errors import EnvCraftError, Skip, Undecided, UsageError
    from envcraft.generation.generators import Generator
    from envcraft.generation.stages import Stage
    from envcraft.judging.check import Check, Rule
    from envcraft.judging.driver import Driver, Worker
    from envcraft.judging.subject import Subject
    from envcraft.model.contract import Contract
    from envcraft.model.rollout import Conditions, Rollout
    from envcraft.model.trace import Trace
    from envcraft.model.verdict import Finding, Repro, Severity, Verdict
    from envcraft.plugins import hookimpl
    from envcraft.reports.reporter import Reporter

#: The module of each public name.
_MODULES = {
    "Check": "judging.check",
    "CheckFailed": "api.validation",
    "Conditions": "model.rollout",
    "Contract": "model.contract",
    "Driver": "judging.driver",
    "EnvCraftError": "errors",
    "ExecutorPlugin": "corpus.executors",
    "Exporter": "corpus.export.exporter",
    "Family": "environments.families",
    "Finding": "model.verdict",
    "Generated": "environments.families",
    "Generator": "generation.generators",
    "Player": "demonstrations.player",
    "Reporter": "reports.reporter",
    "Repro": "model.verdict",
    "Rollout": "model.rollout",
    "Rule": "judging.check",
    "Severity": "model.verdict",
    "Skip": "errors",
    "Stage": "generation.stages",
    "Subject": "judging.subject",
    "Trace": "model.trace",
    "Undecided": "errors",
    "UsageError": "errors",
    "Verdict": "model.verdict",
    "Worker": "judging.driver",
    "check_env": "api.validation",
    # The entry point of registered ids, which exported data sets name too.
    "create": "environments.registration",
    "hookimpl": "plugins",
    "make": "environments.factory",
    "make_vec": "environments.vector",
    "names": "environments.sources",
    "register": "environments.registration",
    "validate": "api.validation",
}

__all__ = [
    "Check", "CheckFailed", "Conditions", "Contract", "Driver", "EnvCraftError", "ExecutorPlugin", "Exporter", "Family",
    "Finding", "Generated", "Generator", "Player", "Reporter", "Repro", "Rollout", "Rule", "Severity", "Skip",
    "Stage", "Subject", "Trace", "Undecided", "UsageError", "Verdict", "Worker", "__version__", "check_env", "create",
    "hookimpl", "make", "make_vec", "names", "register", "validate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULES and name != "testing":
        raise AttributeError(f"module 'envcraft' has no attribute {name!r}")
    import importlib

    if name == "testing":
        # A module, because it needs hypothesis.
        return importlib.import_module("envcraft.testing")
    return getattr(importlib.import_module(f"envcraft.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES, "testing"})
