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
a hundred times as much. That it passes says that something was learnt, not that it takes the frame: what one held
action wins is the business of `difficulty`. Doing nothing is held against the agent here, since it often beats random
play.

All play the same seeds, so the interval is that of the mean difference by seed (Student's t).

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
from collections.abc import Iterator
from functools import partial
from math import isfinite
from statistics import fmean
from typing import TYPE_CHECKING

from envcraft.check import Check, Rule, Skip
from envcraft.errors import EnvCraftError, EnvironmentFailed, UsageError
from envcraft.rollout import Rollout
from envcraft.shrink import repro, shrink
from envcraft.stats import lead
from envcraft.verdict import Finding, Severity

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

#: Steps of training, and episodes of each player.
_BUDGETS = {"quick": (3_000, 30), "standard": (20_000, 60), "thorough": (100_000, 120)}
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
        from envcraft_dqn.learner import Diverged
        from envcraft_dqn.short_training import compare

        steps, episodes = _BUDGETS[subject.budget.name]
        env = None
        try:
            env = SubjectEnv(subject.env_class or "the environment", subject)
            played = compare(subject, env, steps, episodes)
        except UsageError as error:
            raise Skip(str(error)) from None
        except Diverged:
            raise Skip("a loss is not finite, as after a reward that is not; the check reward tells more") from None
        except EnvironmentFailed as error:
            if env is None or env.failed is None:
                raise
            yield self._broken(subject, env.failed, error)
            return
        returns = {name: one.returns for name, one in played.items()}
        if not all(isfinite(total) for totals in returns.values() for total in totals):
            raise Skip("a return is not finite; the check reward tells more")
        means = {name: fmean(totals) for name, totals in returns.items()}
        told = ", ".join(f"{name} {mean:.3g}" for name, mean in means.items())
        words = f"after {steps:,} steps of training, mean returns of {episodes} episodes: {told}"
        for code, other in (("EC851", "random play"), ("EC852", "doing nothing")):
            if other not in returns:
                continue
            found = lead(returns["the agent"], returns[other])
            if found.low <= 0:
                yield self.finding(
                    code,
                    f"{words}; the agent's lead over {other} is {found.mean:.3g} with a 95% interval from "
                    f"{found.low:.3g} to {found.high:.3g}, not above zero",
                    means=means,
                    lead={"estimate": found.mean, "low": found.low, "high": found.high, "n": episodes},
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
        # Where trying takes all the time that there is, what was seen is no less true.
        with contextlib.suppress(Skip):
            if _breaks(subject, rollout):
                small = shrink(rollout, len(rollout.actions), partial(_breaks, subject), subject.contract.noop)
        return self.finding("EC853", f"an episode of training breaks: {error}", line=line, repro=repro(small))


def _breaks(subject: Subject, rollout: Rollout) -> bool:
    trace = subject.rollout(rollout)
    return not trace.usable or any(problem.kind == "type" for problem in trace.problems)
