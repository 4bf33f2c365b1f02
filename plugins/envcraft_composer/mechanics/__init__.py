"""Mechanics with a module of their own. Each module defines GROUP, the name of a group, and MECHANIC."""

from __future__ import annotations

import importlib
import pkgutil

from envcraft_composer.mechanic import Mechanic


def found(group: str) -> tuple[Mechanic, ...]:
    """The mechanics of a group that have a module here, by the names of the modules."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    modules = [importlib.import_module(f"{__name__}.{name}") for name in names]
    return tuple(module.MECHANIC for module in modules if group == module.GROUP)
