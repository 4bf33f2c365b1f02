"""# observation

## What it does
Checks that the observation carries information. It must change in some episode. It must not be independent noise. The
same seed under different actions must lead to different observations. `render()` must return the observation if the
contract requires it, or makes it optional and there is one. A picture that changes only when the agent acts, or
changes rarely, is fine.

A picture is frozen if it changes for the last time at the same step in episodes of several seeds and policies, and at
least half of each of these episodes follows that step. No other play may change it later: held actions, all actions in
rotation, or exploration. A game that gets stuck does so at different steps, and a game that waits for the right action
receives it from some policy.

Noise is measured on the pixels that vary: each one minus its mean over time, correlated with itself one to four steps
later while one action is held. The picture is noise if more than half of it changes at each step, no lag correlates,
and no picture is a shifted copy of the one before.

## Why is this bad?
An agent sees only the observation. If it does not show the game, the agent can learn nothing from it, however good the
game is.

## Example
```python
def _draw(self):
    frame = self.background.copy()
    frame[self.start_y, self.start_x] = WHITE   # EC403: draws where the player was, not where it is
```
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import Rollout
from envcraft.model.verdict import Finding
from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace
    from envcraft.spaces.spec import SpaceSpec

_WATCHED = 64
#: The match of the best shift: 0.05 for independent noise and up to 0.35 if it has large blocks, 0.65 for a picture
#: that scrolls by a quarter of its width, and 1 for one that wraps around.
_MATCHES = 0.5
#: Steps without a change before a picture counts as frozen. If it stopped changing before this share of the last change
#: of the others, its last actions may have had no effect.
_STILL, _NEARLY = 30, 0.9
#: Episodes that must freeze.
_FROZEN = 4


class Observation(Check):
    name = "observation"
    rules = (
        Rule(
            "EC401",
            "constant",
            "The observation never changes, or stops changing at some step.",
            "Draw the frame after the change of state.",
        ),
        Rule(
            "EC402", "noise", "The observation is independent noise.", "Draw the state of the game, not random pixels."
        ),
        Rule("EC403", "unresponsive", "The observation does not react to actions.", "Draw what the agent controls."),
        Rule("EC404", "unlike-render", "The observation differs from render().", "Draw both with one method."),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [trace for trace in subject.played() if len(trace.observations) > 1]
        if not traces:
            raise Skip("no episode has a second observation")
        longest = max(traces, key=lambda trace: trace.steps)
        if _only_value(subject.observation_space):
            raise Skip("the observation space has only one value")
        if subject.contract.observation is None and longest.steps == 1:
            raise Skip("every episode is one step long, and no agent acts on its last observation")
        seen = [trace for trace in traces if not trace.opaque]
        if len(seen) == len(traces) and all(len(set(trace.observations)) == 1 for trace in traces):
            yield self.finding(
                "EC401",
                f"the observation does not change in any of {len(traces)} episodes, "
                f"{sum(trace.steps for trace in traces)} steps in total",
                line=subject.line_of("step"),
                repro=repro(longest.rollout.cut(20)),
            )
        elif (noise := self._find_noise(subject)) is not None:
            yield noise
        elif (unmoved := self._find_unresponsive(subject, seen)) is not None:
            yield unmoved
        elif (frozen := self._find_frozen(subject, seen)) is not None:
            yield frozen
        yield from self._find_unlike_render(subject)
        if len(seen) < len(traces):
            raise Skip("some observations cannot be compared: they have types of another package, or are too large")

    def _find_noise(self, subject: Subject) -> Finding | None:
        if not _pictures(subject.observation_space) or not all(_always_changes(trace) for trace in subject.held()):
            return None
        watched = []
        for action in (subject.joint_actions[0], subject.joint_actions[-1]):
            rollout = self._watch(subject, action)
            trace = subject.rollout(rollout)
            measured = noise(trace.frames)
            if measured is None or not measured[0]:
                return None
            watched.append((rollout, measured))
        rollout, (_, changing, correlation) = watched[0]
        return self.finding(
            "EC402",
            f"{changing:.0%} of the picture changes at each step, independently of the steps before "
            f"(correlation at most {correlation:.2f})",
            line=subject.line_of("step"),
            repro=repro(rollout),
            changing=changing,
            correlation=correlation,
        )

    def _watch(self, subject: Subject, action: Any) -> Rollout:
        return Rollout(subject.episode_seed(0), [action] * _WATCHED, player=f"holding {action}", keep=_WATCHED)

    def _find_unresponsive(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        compared, longest = 0, None
        by_seed: dict[int, list[Trace]] = {}
        for trace in traces:
            by_seed.setdefault(trace.rollout.seed, []).append(trace)
        for same in by_seed.values():
            for trace in same[1:]:
                if trace.rollout.actions == same[0].rollout.actions:
                    continue
                if _seen_apart(same[0], trace):
                    return None
                if subject.contract.observation is None and _paid_apart(same[0], trace):
                    # As in a bandit, or a memory task: the reward reflects the actions.
                    return None
                compared += 1
                longest = trace if longest is None or trace.steps > longest.steps else longest
        if compared < 3 or longest is None or longest.steps < 2:
            return None
        first = subject.episodes.whole[0]
        if any(_seen_apart(first, trace) for trace in subject.episodes.more_held()):
            return None
        return self.finding(
            "EC403",
            f"on the same seed the observations do not depend on the actions ({compared} comparisons, "
            f"up to {longest.steps} steps)",
            line=subject.line_of("step"),
            repro=repro(longest.rollout.cut(longest.steps)),
            compared=compared,
        )

    def _find_frozen(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        if not _pictures(subject.observation_space) or not traces:
            return None
        last, busy, frozen = _frozen(traces)
        if not _enough(frozen) and _is_still(subject.episodes.whole[0], last):
            whole = itertools.islice(subject.episodes.more_whole(), _FROZEN)
            last, busy, frozen = _frozen([*traces, *(trace for trace in whole if trace.observations)])
        if not _enough(frozen) or 2 * len(frozen) < len(busy):
            return None
        if any(_last_change(trace) < _NEARLY * last for trace in busy):
            return None
        others = [*subject.episodes.rotations, *subject.episodes.more_held(), *subject.searches.explored()]
        if any(trace.opaque or _last_change(trace) > last for trace in others):
            return None
        longest = max(frozen, key=lambda trace: trace.steps)
        return self.finding(
            "EC401",
            f"the picture freezes: it does not change after step {last} in any of {len(traces) + len(others)} "
            f"episodes, up to step {longest.steps}",
            line=subject.line_of("step"),
            repro=repro(longest.rollout.cut(longest.steps)),
            step=last,
            episodes=len(frozen),
        )

    def _find_unlike_render(self, subject: Subject) -> Iterator[Finding]:
        if not (subject.contract.render and subject.renders):
            return
        trace = subject.rendered()
        differing = [problem for problem in trace.render_problems if problem.kind == "differs"]
        # The check api reports an observation of the wrong type.
        bad = {problem.step for problem in trace.problems}
        differing = [problem for problem in differing if problem.step not in bad]
        if differing:
            step = differing[0].step
            at = "the reset" if step == 0 else f"step {step}"
            yield self.finding(
                "EC404",
                f"after {at} render() returns another picture than the observation",
                line=subject.line_of("render"),
                repro=repro(trace.rollout.cut(step)),
                step=step,
            )


def _is_still(trace: Trace, last: int) -> bool:
    """Whether a long time without a change follows the `last` change."""
    return trace.usable and trace.steps >= max(2 * last, last + _STILL)


def _frozen(traces: list[Trace]) -> tuple[int, list[Trace], list[Trace]]:
    """The last change of all, the episodes with varied actions long after it, and those of them that change last."""
    last = max(map(_last_change, traces))
    long = [trace for trace in traces if _is_still(trace, last)]
    # An idle player may stop all motion by itself.
    busy = [trace for trace in long if len({str(action) for action in trace.actions[last : trace.steps]}) > 1]
    return last, busy, [trace for trace in busy if _last_change(trace) == last]


def _enough(frozen: list[Trace]) -> bool:
    return len(frozen) >= _FROZEN and len({trace.rollout.seed for trace in frozen}) > 1


def _always_changes(trace: Trace) -> bool:
    """Whether every step changes the observation, as noise does."""
    return all(_changed(trace, step) for step in range(1, len(trace.observations)))


def _last_change(trace: Trace) -> int:
    """The last step that changed the observation; 0 if none did."""
    changes = (step for step in range(len(trace.observations) - 1, 0, -1) if _changed(trace, step))
    return next(changes, 0)


def _changed(trace: Trace, step: int) -> bool:
    return trace.observations[step] != trace.observations[step - 1]


def _seen_apart(one: Trace, two: Trace) -> bool:
    return any(first != second for first, second in zip(one.observations, two.observations, strict=False))


def _paid_apart(one: Trace, two: Trace) -> bool:
    return any(first != second for first, second in zip(one.rewards, two.rewards, strict=False))


def _pictures(space: SpaceSpec) -> bool:
    """Whether observations are pictures. A short vector may be drawn anew at each step, as in a bandit."""
    from envcraft.spaces.spec import Box

    return isinstance(space, Box) and len(space.shape) >= 2 and space.dtype == "uint8"


def _only_value(space: SpaceSpec) -> bool:
    from envcraft.spaces.spec import Box, Discrete

    if isinstance(space, Box):
        return space.bounded and space.low == space.high
    return isinstance(space, Discrete) and space.n == 1


def noise(frames: Sequence[Any]) -> tuple[bool, float, float] | None:
    """Whether frames are independent in time.

    Args:
        frames: consecutive frames, at least 12 arrays of one shape.

    Returns:
        The verdict, the share of values that change from frame to frame, and the highest correlation of a pixel with
        itself one to four frames later; None if the frames are too few or differ in shape.
    """
    import numpy as np

    if len(frames) < 12 or len({frame.shape for frame in frames}) != 1:
        return None
    stack = np.stack(frames[1:]).reshape(len(frames) - 1, -1).astype(np.float32)
    changing = float(np.mean(stack[1:] != stack[:-1]))
    rest = stack - stack.mean(axis=0)
    power = float(np.mean(rest**2))
    if power == 0:
        return False, changing, 1.0
    highest = max(abs(float(np.mean(rest[lag:] * rest[:-lag]))) / power for lag in range(1, 5))
    return changing > 0.5 and highest < 0.15 and not _moves(frames[1:]), changing, highest


def _moves(frames: Sequence[Any]) -> bool:
    """Whether most pictures are a shifted copy of the one before.

    The method is phase correlation (Kuglin and Hines, "The phase correlation image alignment method", 1975). For
    independent noise no shift stands out; a shift by zero does not count.
    """
    import numpy as np

    grey = np.stack(frames).astype(np.float32)
    grey = grey.mean(axis=3) if grey.ndim == 4 else grey
    if grey.ndim != 3:
        return False
    spectra = np.fft.rfft2(grey - grey.mean(axis=(1, 2), keepdims=True))
    cross = spectra[1:] * spectra[:-1].conj()
    matches = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-9), s=grey.shape[1:])
    matches[:, 0, 0] = 0
    return bool(np.median(matches.max(axis=(1, 2))) > _MATCHES)


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Observation()]
