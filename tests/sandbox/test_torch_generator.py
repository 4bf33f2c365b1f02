"""torch's global generator is seeded whenever the code under test imports torch."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
from envcraft_sandbox.worker import torch_generator

TORCH = """
class Generator:
    __module__ = "torch._C"
    state = None
    def manual_seed(self, seed): self.state = [seed]
    def get_state(self): return list(self.state)
    def set_state(self, state): self.state = state

default_generator = Generator()
"""


@pytest.fixture(autouse=True)
def torch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module with the name of torch, which is not imported yet."""
    (tmp_path / "torch.py").write_text(TORCH)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path])
    # Set first, so that what a test imports under this name is gone after it.
    monkeypatch.setitem(sys.modules, "torch", ModuleType("torch"))
    monkeypatch.delitem(sys.modules, "torch")


def imported() -> ModuleType:
    return importlib.import_module("torch")


def test_the_import_is_followed_by_the_last_seed() -> None:
    torch_generator.seed(3)
    torch_generator.seed(5)
    # As code does that asks whether torch is installed.
    assert importlib.util.find_spec("torch") is not None
    assert "torch" not in sys.modules
    assert imported().default_generator.state == [5]
    torch_generator.seed(7)
    assert imported().default_generator.state == [7]


def test_a_state_from_before_the_import_is_restored() -> None:
    torch_generator.seed(3)
    before = torch_generator.get()
    torch_generator.seed(4)
    torch_generator.put(before)
    generator = imported().default_generator
    assert generator.state == [3]
    generator.state.append("drawn")
    later = torch_generator.get()
    torch_generator.put(before)
    assert generator.state == [3]
    torch_generator.put(later)
    assert generator.state == [3, "drawn"]


def test_another_module_of_that_name_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text("default_generator = object()")
    torch_generator.seed(3)
    imported()
    assert torch_generator.get() == 3
