"""What the sandbox tests share: tiny environments made of a few hostile lines, and jobs that run them under short
limits.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.driver import Limits, Player, Worker
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.model.job import JobResult
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.trace import Trace
from envcraft.spaces.spec import read_space

LIMITS = Limits(
    call=1.0, loading=2.0, job=20.0, memory=512 * 1024**2, file=1024**2, output=4096, output_total=256 * 1024
)

_ENVIRONMENT = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces
{top}

class Tiny(gym.Env):
    def __init__(self):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def _frame(self):
        return self.np_random.integers(0, 256, (84, 84, 3), dtype=np.uint8)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
{reset}
        return self._frame(), {{}}

    def step(self, action):
        self.steps += 1
{step}
        return self._frame(), float(action[0]), False, self.steps == 8, {{"steps": self.steps}}
"""


def environment(*, top: str = "", reset: str = "", step: str = "") -> str:
    """Source of an environment of eight random frames, with lines of one's own."""

    def indented(lines: str) -> str:
        return textwrap.indent(textwrap.dedent(lines), " " * 8)

    return _ENVIRONMENT.format(top=textwrap.dedent(top), reset=indented(reset), step=indented(step))


@dataclass(frozen=True)
class Ran:
    """What came of one job."""

    end: JobResult
    trace: Trace
    description: Any

    @property
    def facts(self) -> Any:
        """What the job printed, as JSON."""
        assert self.end.reason == "done", (self.end, self.trace.fault)
        assert self.trace.fault is None, self.trace.fault
        return json.loads(self.end.output)


Play = Callable[..., Ran]


def play(
    worker: Worker,
    source: str,
    *,
    kind: str = "rollout",
    seed: int = 0,
    limits: Limits = LIMITS,
    player: Player | None = None,
    series: bool = False,
    new_process: bool = False,
    conditions: Conditions | None = None,
    project: Any = None,
    fields: bool = False,
) -> Ran:
    """Run one job: by default a rollout of ten actions, with a `player` one of at most ten that it chooses."""
    listed = [] if player else [[number % 5, 0, 1] for number in range(10)]
    rollout = Rollout(
        seed=seed, actions=listed, interactive=player is not None, max_steps=10 if player else 0, fields=fields
    )
    rollout = rollout.under(conditions or Conditions())
    recording = TraceBuilder(rollout, read_space(ARCADE.observation), read_space(ARCADE.action))
    job: Any = {
        "kind": kind,
        "target": {"kind": "source", "source": source, "filename": "tiny.py"},
        "contract": ARCADE.for_worker(),
        "seed": rollout.seed,
        "actions": rollout.actions,
        "conditions": rollout.conditions.to_json(),
        "interactive": rollout.interactive,
        "max_steps": rollout.max_steps,
        "frame": recording.frame,
        "pictures": recording.pictures,
        "series": series,
        "new_process": new_process,
        "fields": fields,
    }
    if project is not None:
        job["target"]["project"] = project
    end = worker.run(job, recording, limits, player)
    recording.trace.end = end
    return Ran(end, recording.trace, recording.description)


@pytest.fixture(scope="module", autouse=True)
def shared_zygotes() -> None:
    """Start workers as a run does, because these tests are about that."""


@pytest.fixture(name="play", scope="session")
def _play() -> Play:
    return play


@pytest.fixture(scope="session")
def limits() -> Limits:
    """Short ones."""
    return LIMITS


@pytest.fixture(name="environment", scope="session")
def _environment() -> Callable[..., str]:
    return environment
