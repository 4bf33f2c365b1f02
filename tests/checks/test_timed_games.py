"""How easy a game is stays open if the time of day decides it, or one seed for all episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import envcraft

#: Rocks fall only at moments that play hardly meets here.
ROCKS = """
import time
import gymnasium as gym
class Dodge(gym.Env):
    observation_space = gym.spaces.Discrete(200)
    action_space = gym.spaces.Discrete(2)
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.time = int(self.np_random.integers(100)), 0
        return self.at, {"is_success": False}
    def step(self, action):
        self.time += 1
        hit = MOMENT
        won = self.time >= 20 and not hit
        return self.at + self.time, float(won), hit or won, False, {"is_success": won}
"""


@pytest.mark.parametrize("check", ["instawin", "difficulty"])
def test_a_game_that_reads_the_clock_is_not_called_easy(check: str) -> None:
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick", "checks": check}

    def judged(moment: str) -> Any:
        report = envcraft.validate(ROCKS.replace("MOMENT", moment), **options)
        return next(each for each in report.reports[0].checks if each.check == check)

    assert judged("self.time < 0").findings
    timed = judged("time.time() < 100")
    assert not timed.findings
    assert timed.undecided
    assert "line 13 reads the clock" in timed.reason


@pytest.mark.parametrize("check", ["instawin", "difficulty"])
@pytest.mark.parametrize(
    ("helper", "undecided"),
    [
        ("def now():\n    return time.time()\n", True),
        ("def now():\n    return 100 if time.time() < 9 else 101\n", True),
        # A file that only measures how long it takes decides nothing.
        ("def now():\n    start = time.time()\n    print(time.time() - start)\n    return 100\n", False),
    ],
)
def test_a_clock_in_a_helper_file_counts_where_play_uses_it(
    check: str, helper: str, undecided: bool, tmp_path: Path
) -> None:
    (tmp_path / "helper.py").write_text(f"import time\n\n\n{helper}")
    file = tmp_path / "dodge.py"
    file.write_text(ROCKS.replace("import time", "from helper import now").replace("MOMENT", "now() < 100"))
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick", "checks": check}
    [judged] = [each for each in envcraft.validate(file, **options).reports[0].checks if each.check == check]
    assert judged.undecided == undecided
    assert bool(judged.findings) != undecided
    assert not undecided or "helper.py line" in judged.reason


@pytest.mark.parametrize("check", ["instawin", "difficulty"])
@pytest.mark.parametrize(
    ("top", "made", "undecided"),
    [
        ("    def __init__(self):\n        self.rng = random.Random(3)\n", "", True),
        ("    rng = random.Random(3)\n", "", True),
        # Each seed gives another episode.
        ("    def __init__(self):\n        self.rng = random.Random(3)\n", "self.rng = random.Random(seed)", False),
        ("    rng = random.Random(3)\n", "self.rng = random.Random(seed)", False),
        ("    rng = random.Random(3)\n", "self.rng.seed(seed)", False),
    ],
)
def test_a_game_with_one_seed_for_all_episodes_is_not_called_easy(
    check: str, top: str, made: str, undecided: bool
) -> None:
    text = ROCKS.replace("import time", "import random").replace("MOMENT", "self.rng.random() < 1e-9")
    text = text.replace("    def reset", f"{top}    def reset").replace("seed=seed)\n", f"seed=seed)\n        {made}\n")
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick", "checks": check}
    [judged] = [each for each in envcraft.validate(text, **options).reports[0].checks if each.check == check]
    assert judged.undecided == undecided
    assert bool(judged.findings) != undecided
    assert not undecided or "with a fixed seed" in judged.reason
