"""Which class of a file is its environment."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import gymnasium
import pytest
from envcraft_protocol.classes import concrete_classes, rendering
from envcraft_sandbox.worker.targets import execute

BASE = """
from abc import abstractmethod
import gymnasium

class Grid(gymnasium.Env):
    def reset(self, *, seed=None, options=None):
        return self.draw(), {}

    def step(self, action):
        return self.draw(), 0.0, False, False, {}

    %s

class Game(Grid):
    def draw(self):
        return None
"""
RAISES = "def draw(self):\n        '''Of the game's own.'''\n        raise NotImplementedError('draw')"


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    yield
    sys.modules.pop("classes_of_a_test", None)


def found(source: str) -> list[str]:
    return concrete_classes(execute("classes_of_a_test", source, f"<{hash(source)}>"))


@pytest.mark.parametrize("hook", [RAISES, "@abstractmethod\n    def draw(self):\n        ..."])
def test_a_base_that_leaves_a_method_open_is_no_environment(hook: str) -> None:
    assert found(BASE % hook) == ["Game"]


@pytest.mark.parametrize("hook", ["def draw(self):\n        pass", "def draw(self):\n        return 1"])
def test_a_base_that_is_complete_is_one(hook: str) -> None:
    assert found(BASE % hook) == ["Grid", "Game"]


def test_what_is_made_of_an_open_base_may_be_open_itself() -> None:
    further = (
        "\nclass Other(Grid):\n    '''Draws nothing.'''\n\nclass Last(Other):\n    def draw(self):\n        return 2\n"
    )
    assert found(BASE % RAISES + further) == ["Game", "Last"]


def test_nothing_is_made_of_the_only_class_that_refuses_to_draw() -> None:
    assert found((BASE % RAISES).partition("class Game")[0]) == ["Grid"]


@pytest.mark.parametrize(
    ("metadata", "requested"),
    [
        (None, True),
        ({"render_fps": 30}, True),
        ({"render_modes": ["human", "rgb_array"]}, True),
        ({"render_modes": ["ansi"]}, False),
        ({"render_modes": []}, False),
    ],
)
def test_frames_are_requested_unless_the_class_excludes_them(metadata: Any, requested: bool) -> None:
    class Game(gymnasium.Env[Any, Any]):
        def __init__(self, render_mode: str | None = None) -> None:
            self.render_mode = render_mode

    if metadata is not None:
        Game.metadata = metadata
    assert rendering(Game, {}) == ({"render_mode": "rgb_array"} if requested else {})
