"""The global generator of torch, of code that imports torch: no worker imports it itself."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_NAME = "torch"


def seed(state: int) -> None:
    """Seed the generator now, or as soon as torch is imported."""
    _after_import.state = state
    if (generator := _generator()) is not None:
        generator.manual_seed(state)
    elif _NAME not in sys.modules and _after_import not in sys.meta_path:
        sys.meta_path.insert(0, _after_import)


def get() -> Any:
    """The state of the generator, or the seed that it will have if torch is imported."""
    generator = _generator()
    return generator.get_state() if generator is not None else _after_import.state


def put(state: Any) -> None:
    """Restore what :func:`get` returned."""
    generator = _generator()
    if generator is None or isinstance(state, int):
        seed(state)
    else:
        generator.set_state(state)


def _generator() -> Any:
    """The generator; None if torch is not imported, or something else has its name."""
    generator = getattr(sys.modules.get(_NAME), "default_generator", None)
    return generator if type(generator).__module__.startswith("torch.") else None


class _AfterImport(MetaPathFinder):
    """Seeds the generator right after torch is imported. Torch itself seeds it with the time."""

    state = 0

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _NAME:
            return None
        others = (finder.find_spec(fullname, path, target) for finder in sys.meta_path if finder is not self)
        spec = next((found for found in others if found is not None), None)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def execute_and_seed(module: ModuleType) -> None:
            execute(module)
            seed(self.state)

        spec.loader.exec_module = execute_and_seed  # type: ignore[method-assign]
        return spec


_after_import = _AfterImport()
