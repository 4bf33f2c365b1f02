"""# learnability

## What it does
Trains a small agent by the environment's frames alone, in the sandbox, and asks whether it then does better than random
play: whether the mean return of its episodes is higher, with a 95% interval of the difference that lies above zero. It
is the learner of `envcraft train` with its smallest network (166,549 parameters), on one processor, and follows from
`--seed`.

It runs only where `--checks learnability` asks for it, since it takes minutes: 3,000 steps of training and 30 episodes
of each player at the budget `quick`, 20,000 and 60 at `standard`, 100,000 and 120 at `thorough`. It needs frames of
bytes and a pad, as the contract `arcade` has them, and the libraries of the extra `train`.

That it fails says that so much training was not enough, and no more: a sparse reward, or a game of long plans, may want
a hundred times as much. Doing nothing is held against the agent, too: often it beats random play without anything
having been learnt.

## Why is this bad?
A benchmark is meant to tell agents apart. In an environment whose frames or rewards say nothing about what to do, all
of them do as well as chance.

## Example
```python
reward = float(self.np_random.random() < 0.5)      # EC851: whatever is done, chance decides what it is worth
```
"""

from __future__ import annotations

import contextlib
import importlib.util
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envcraft.check import Check, Rule, Skip
from envcraft.errors import EnvCraftError, EnvironmentFailed, UsageError
from envcraft.rollout import Rollout
from envcraft.shrink import repro, shrink
from envcraft.verdict import Finding, Severity

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace
    from envcraft.using.sandboxed import SubjectEnv
    from envcraft_dqn.evaluation import Evaluation

#: Steps of training, and episodes of each player.
_BUDGETS = {"quick": (3_000, 30), "standard": (20_000, 60), "thorough": (100_000, 120)}
#: Random actions of the agent that is tested, as Mnih et al. 2015 (doi:10.1038/nature14236) have them: a greedy one may
#: do the same thing for ever.
_EPSILON = 0.05
_LIBRARIES = ("numba", "safetensors", "torch", "zstandard")


class Learnability(Check):
    name = "learnability"
    opt_in = True
    rules = (
        Rule(
            "EC851",
            "not-learnt",
            "A short training by frames does not beat random play.",
            "Show in the frame what the reward depends on, and pay for more than the end; or train longer.",
        ),
        Rule(
            "EC852",
            "idle-does-as-well",
            "What a short training learns is no better than doing nothing.",
            "Pay for what takes an action.",
            Severity.WARNING,
        ),
        Rule(
            "EC853",
            "training-breaks",
            "An episode of training ends in an exception or a sandbox event.",
            "Run `envcraft replay` on the finding, and mend what it shows.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        missing = [name for name in _LIBRARIES if importlib.util.find_spec(name) is None]
        if missing:
            raise EnvCraftError(f"training needs {', '.join(missing)}; `pip install 'envcraft-rl[train]'` has it")
        from envcraft.using.sandboxed import SubjectEnv

        steps, episodes = _BUDGETS[subject.budget.name]
        try:
            env = SubjectEnv(subject.env_class or "the environment", subject)
        except UsageError as error:
            raise Skip(str(error)) from None
        try:
            with _one_thread():
                played = _played(env, steps, episodes, subject.seed, idle=subject.contract.noop is not None)
        except UsageError as error:
            raise Skip(str(error)) from None
        except EnvironmentFailed as error:
            if env.failed is None:
                raise
            yield self._broken(subject, env.failed, error)
            return
        means = {name: one.total.mean for name, one in played.items()}
        told = ", ".join(f"{name} {mean:.3g}" for name, mean in means.items())
        words = f"after {steps:,} steps of training, mean returns of {episodes} episodes: {told}"
        for code, other in (("EC851", "random play"), ("EC852", "doing nothing")):
            if other not in played:
                continue
            lead, low, high = _lead(played["the agent"], played[other])
            if low <= 0:
                yield self.finding(
                    code,
                    f"{words}; the agent's lead over {other} is {lead:.3g} with a 95% interval from {low:.3g} to "
                    f"{high:.3g}, not above zero",
                    means=means,
                    lead={"estimate": lead, "low": low, "high": high, "n": episodes},
                    steps=steps,
                )
                return

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code == "EC853":
            return finding if _breaks(subject, Rollout(finding.repro.seed, finding.repro.actions)) else None
        return super().confirm(subject, finding)

    def _broken(self, subject: Subject, trace: Trace, error: EnvironmentFailed) -> Finding:
        rollout = Rollout(trace.rollout.seed, trace.actions, player="training")
        line = trace.fault.line if trace.fault is not None else None
        small = rollout
        if _breaks(subject, rollout):
            small = shrink(rollout, len(rollout.actions), partial(_breaks, subject), subject.contract.noop)
        return self.finding("EC853", f"an episode of training breaks: {error}", line=line, repro=repro(small))


def _breaks(subject: Subject, rollout: Rollout) -> bool:
    return not subject.rollout(rollout).usable


def _played(env: SubjectEnv, steps: int, episodes: int, seed: int, idle: bool) -> dict[str, Evaluation]:
    """What a trained agent and its controls come to. Raises UsageError where an agent cannot learn from frames,
    EnvironmentFailed.
    """
    from gymnasium.vector import SyncVectorEnv

    from envcraft_dqn.evaluation import AgentPlayer, NoopPlayer, Player, RandomPlayer, evaluate
    from envcraft_dqn.learner import train
    from envcraft_dqn.settings import Settings
    from envcraft_dqn.spaces import Surface

    def open_vector(names: Sequence[str]) -> Any:
        return SyncVectorEnv([lambda: env], copy=False)

    settings = Settings(
        size="tiny",
        seed=seed,
        steps=steps,
        lanes=1,
        cycle=steps,
        learning_rate=1e-3,
        gamma=0.95,
        target_every=100,
        epsilon_share=0.5,
        capacity=min(steps, 20_000) + 1_000,
        starts=200,
        precision="fp32",
        device="cpu",
    )
    surface = Surface.of(open_vector, "the environment")
    with tempfile.TemporaryDirectory(prefix="envcraft-") as folder:
        agent = train(settings, [""], open_vector, Path(folder), every=float("inf"))
        players: dict[str, Player] = {
            "the agent": AgentPlayer(agent, surface, seed, _EPSILON, "cpu"),
            "random play": RandomPlayer(surface, seed),
        }
    if idle:
        players["doing nothing"] = NoopPlayer()
    found = {}
    for name, player in players.items():
        [found[name]] = evaluate([""], open_vector, player, episodes, lanes=1, seed=seed)
    return found


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """The cores are the subjects' that are judged side by side; and how many there are shall decide no verdict."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _lead(one: Evaluation, other: Evaluation) -> tuple[float, float, float]:
    """The difference of two mean returns, with the 95% interval of the normal distribution."""
    lead = one.total.mean - other.total.mean
    half = 1.959964 * (one.total.standard_error**2 + other.total.standard_error**2) ** 0.5
    return lead, lead - half, lead + half
