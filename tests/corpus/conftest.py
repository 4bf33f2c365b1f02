"""Fixtures for the tests of corpora: a store with verdicts of every kind, made without judging."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from envcraft.cli.group import cli
from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.store import Environment, Store
from envcraft.judging.settings import Settings, contract_digest
from envcraft.model.verdict import CheckReport, Finding, Severity, SubjectReport, Verdict

SETTINGS = Settings("arcade", contract_digest(ARCADE), "0.1.0+rules", 0, "quick", "process", "python 3")
Invoke = Callable[..., Result]
#: The options of a short audit.
QUICK = ("--sandbox", "process", "--budget", "quick", "--checks", "source,api", "--workers", "2")
#: An environment that crashes at the position CRASH.
ENVIRONMENT = """import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Walk(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 5
        return self.render(), {}

    def step(self, action):
        self.x = max(self.x + {3: -1, 4: 1}.get(int(action[0]), 0), 0)
        if self.x == CRASH:
            raise RuntimeError("over the edge")
        return self.render(), float(self.x > 9), self.x > 9, False, {}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[40:44, self.x * 6 : self.x * 6 + 6] = 255
        return frame
"""


def source(name: str) -> bytes:
    """A source that a scan of a folder accepts as an environment."""
    return f"import gymnasium\nclass {name.title()}(gymnasium.Env):\n    pass\n".encode()


def report(name: str, *codes: str, verdict: Verdict | None = None, steps: int = 7) -> SubjectReport:
    findings = [Finding(code, Severity.ERROR, f"{code} was found", 3, {"share": 0.5}) for code in codes]
    verdict = verdict or (Verdict.FAIL if codes else Verdict.PASS)
    sha256 = hashlib.sha256(source(name)).hexdigest()
    return SubjectReport(
        name, name.title(), sha256, verdict, "process", 0.25, steps, [CheckReport("api", verdict, 0.1, findings)]
    )


def told(reports: list[dict[str, Any]]) -> Any:
    """Reports without their times."""

    def without(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: without(item) for key, item in value.items() if key != "seconds"}
        return [without(item) for item in value] if isinstance(value, list) else value

    return without(reports)


def judged(store: Store, name: str, *codes: str, verdict: Verdict | None = None) -> None:
    """Add an environment with a verdict."""
    store.add(name, source(name))
    environment = Environment(name, hashlib.sha256(source(name)).hexdigest(), "")
    store.record(environment, store.settings(SETTINGS), report(name, *codes, verdict=verdict))


def rows(store: Store) -> list[tuple[object, ...]]:
    """All rows without their ids and times."""
    return [
        *store.db.execute(
            "SELECT name, e.source, e.class, origin, v.verdict, v.steps, v.report FROM environments e "
            "LEFT JOIN verdicts v ON v.id = e.verdict ORDER BY name"
        ),
        *store.db.execute(
            "SELECT v.source, v.class, s.digest, v.verdict, v.report FROM verdicts v JOIN settings s "
            "ON s.id = v.settings ORDER BY 1, 2, 3"
        ),
        *store.db.execute(
            "SELECT v.source, number, rule_check, code, severity, line, message FROM findings f JOIN verdicts v "
            "ON v.id = f.verdict ORDER BY 1, 2"
        ),
    ]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    """A corpus of four environments: a pass, a failure, an error, and one without a verdict."""
    with Store.create(tmp_path / "corpus") as made:
        judged(made, "ant")
        judged(made, "bee", "EC107", "EC203")
        judged(made, "cat", verdict=Verdict.ERROR)
        made.add("dog", source("dog"), origin={"model": "a"})
        yield made


@pytest.fixture
def invoke(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Invoke:
    """Run the command line in an empty folder without a configuration file."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str | Path) -> Result:
        return CliRunner().invoke(cli, [str(argument) for argument in arguments])

    return run


@pytest.fixture(scope="session")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A corpus with verdicts of every kind and three pictures, and the report on it."""
    from .reported import HOSTILE, fill, picture, written

    folder = tmp_path_factory.mktemp("reported")
    with Store.create(folder / "corpus") as made:
        fill(made)
        for name in (HOSTILE, "games/env0001.py", "games/env0002.py"):
            picture(made, name)
    return folder / "corpus", written(folder / "corpus", folder / "report")
