"""# learnability

## What it does
Trains a small agent on the frames of the environment in the sandbox, and compares it with random play. The check
passes if the mean return of the agent is higher: the 95% confidence interval of the difference must lie above zero. It
uses the learner of `envcraft train` with its smallest network (166,549 parameters) on one CPU core. The result is
reproducible for the same `--seed`.

The check takes minutes and runs only with `--checks learnability`, which raises the time limit to an hour. The budget
`quick` has 3,000 steps of training and 30 episodes of each policy, `standard` has 20,000 and 60, and `thorough` has
100,000 and 120. The check needs frames of bytes and a `MultiDiscrete` action space, as in the contract `arcade`, and
the libraries of the extra `train`.

A failure means that this amount of training was not enough. A sparse reward, or a game that needs long plans, may need
a hundred times as much. A pass means that the agent learned something, but not that it needs the frame: the check
`difficulty` reports games that one held action wins. The check also compares the agent with doing nothing, which often
beats random play.

All policies play the same seeds, so that the interval is that of the mean paired difference (Student's t).

## Why is this bad?
A benchmark must distinguish agents. If neither frames nor rewards contain information about what to do, all agents
perform like chance.

## Example
```python
reward = float(self.np_random.random() < 0.5)      # EC851: the reward does not depend on the action
```
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from math import isfinite
from statistics import fmean
from typing import TYPE_CHECKING

from envcraft.errors import EnvCraftError, EnvironmentFailed, Skip, UsageError
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro, shrink
from envcraft.judging.statistics import lead
from envcraft.model.rollout import Rollout
from envcraft.model.verdict import Finding, Severity

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The steps of training and the episodes of each policy, by budget.
_BUDGETS = {"quick": (3_000, 30), "standard": (20_000, 60), "thorough": (100_000, 120)}
_LIBRARIES = ("numba", "safetensors", "torch", "zstandard")


class Learnability(Check):
    name = "learnability"
    opt_in = True
    rules = (
        Rule(
            "EC851",
            "not-learnt",
            "An agent trained briefly on frames does not beat random play.",
            "Make the causes of rewards visible in the frame, reward progress as well as the end, or train longer.",
        ),
        Rule(
            "EC852",
            "idle-does-as-well",
            "An agent trained briefly on frames does not beat doing nothing.",
            "Reward results that need actions.",
            Severity.WARNING,
        ),
        Rule(
            "EC853",
            "training-breaks",
            "An episode of training ends in an exception or a sandbox event.",
            "Run `envcraft replay` on the finding, and fix the error that it shows.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        missing = [name for name in _LIBRARIES if importlib.util.find_spec(name) is None]
        if missing:
            raise EnvCraftError(
                f"training needs {', '.join(missing)}; install it with `pip install 'envcraft-rl[train]'`"
            )
        from envcraft.environments.sandboxed import SubjectEnv
        from envcraft_dqn.baseline_comparison import compare
        from envcraft_dqn.trainer import Diverged

        steps, episodes = _BUDGETS[subject.budget.name]
        env = None
        try:
            env = SubjectEnv(subject.env_class or "the environment", subject)
            played = compare(subject, env, steps, episodes)
        except UsageError as error:
            raise Skip(str(error)) from None
        except Diverged:
            raise Skip("the loss is not finite, possibly because of a reward; see the check reward") from None
        except EnvironmentFailed as error:
            if env is None or env.failed is None:
                raise
            yield self._failure(subject, env.failed, error)
            return
        returns = {name: one.returns for name, one in played.items()}
        if not all(isfinite(total) for totals in returns.values() for total in totals):
            raise Skip("a return is not finite; see the check reward")
        means = {name: fmean(totals) for name, totals in returns.items()}
        listed = ", ".join(f"{name} {mean:.3g}" for name, mean in means.items())
        summary = f"after {steps:,} steps of training, the mean returns of {episodes} episodes are: {listed}"
        for code, other in (("EC851", "random play"), ("EC852", "doing nothing")):
            if other not in returns:
                continue
            difference = lead(returns["the agent"], returns[other])
            if difference.low <= 0:
                yield self.finding(
                    code,
                    f"{summary}; the lead of the agent over {other} is {difference.mean:.3g} with a 95% confidence "
                    f"interval from {difference.low:.3g} to {difference.high:.3g}, which is not above zero",
                    means=means,
                    lead={"estimate": difference.mean, "low": difference.low, "high": difference.high, "n": episodes},
                    steps=steps,
                )
                return

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code == "EC853":
            trace = subject.rollout(Rollout(finding.repro.seed, finding.repro.actions))
            return finding if _failed(trace) is not None else None
        return super().confirm(subject, finding)

    def _failure(self, subject: Subject, trace: Trace, error: EnvironmentFailed) -> Finding:
        rollout = Rollout(trace.rollout.seed, trace.actions, player="training")
        line = trace.fault.line if trace.fault is not None else None
        small = rollout
        # Without time to shrink the reproduction, the finding keeps the full one.
        with contextlib.suppress(Skip):
            if _failed(subject.rollout(rollout)) is not None:
                length = len(rollout.actions)
                small = shrink(rollout, [length], subject.rollout, _failed, subject.contract.noop)
        return self.finding("EC853", f"an episode of training fails: {error}", line=line, repro=repro(small))


def _failed(trace: Trace) -> int | None:
    """After how many actions an episode fails; None if it does not."""
    wrong = not trace.usable or any(problem.kind == "type" for problem in trace.problems)
    return len(trace.actions) if wrong else None
