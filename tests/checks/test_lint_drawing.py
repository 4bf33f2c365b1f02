"""Pictures that draw random numbers of the game, and those that keep what they have drawn."""

from __future__ import annotations

import pytest

from tests.checks.lint_games import codes

GAME = {
    "reset": "self.x = self.shown = 0; self.picture = None; self.stars = []",
    "step": "self.x = self.np_random.random()",
}


def drawn(see: str, render: str = "return self.see()") -> set[str]:
    return codes(**GAME, see=see, more=f"def render(self):\n        {render}") & {"EC063"}


@pytest.mark.parametrize(
    "see",
    [
        "return self.np_random.random(4)",
        "rng = self.np_random\n        return rng.random(4)",
        "return self.np_random.random(4) if self.x > 0.9 else np.zeros(4)",
    ],
)
def test_numbers_that_each_picture_draws(see: str) -> None:
    assert drawn(see) == {"EC063"}


@pytest.mark.parametrize(
    ("see", "render"),
    [
        (
            "if self.picture is None: self.picture = self.np_random.random(4)\n        return self.picture",
            "return self.see()",
        ),
        (
            "if not self.stars: self.stars = [self.np_random.random()]\n        return np.full(4, self.stars[0])",
            "return self.see()",
        ),
        (
            "if self.shown != self.x:\n            self.shown = self.x"
            "\n            self.picture = self.np_random.random(4)"
            "\n        return self.picture",
            "return self.see()",
        ),
        ("return self.np_random.random(4)", "return self.picture"),
        (
            "kept = self.np_random.bit_generator.state\n        seen = self.np_random.random(4)"
            "\n        self.np_random.bit_generator.state = kept\n        return seen",
            "return self.see()",
        ),
    ],
)
def test_numbers_that_are_drawn_once(see: str, render: str) -> None:
    assert drawn(see, render) == set()
