"""# observation

## What it does
Asks whether the picture tells an agent anything. It must change in some episode; it must not be independent noise;
the same seed under different actions must give different pictures sooner or later; and `render()` must give the
observation where the contract says so. A picture that stands still until the agent acts is fine, and so is one that
changes rarely.

A picture that freezes is one that changes for the last time at the very same step in episodes of several seeds and
players, half of each of which follows that step. Whatever else is played must not change it later, neither holding a
button, nor trying all in turn, nor exploration. A game that gets stuck does so sooner or later, and one that waits for
the right action is moved by somebody.

Noise is judged on the pixels that vary: each minus its mean over time, correlated with itself one to four steps
later while one action is held. Where more than half of the picture changes at each step, no lag correlates, and no
picture is the one before moved by some pixels, it is noise.

## Why is this bad?
An agent sees nothing but the observation. Where that does not show the game, nothing can be learned from it, however
good the game is.

## Example
```python
def _draw(self):
    frame = self.background.copy()
    frame[self.start_y, self.start_x] = WHITE   # EC403: draws where the player was, not where it is
```
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from envcraft.check import Check, Rule, Skip
from envcraft.plugins import hookimpl
from envcraft.rollout import Conditions, Rollout
from envcraft.shrink import repro
from envcraft.verdict import Finding

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

_WATCHED = 64
_RENDERED = 200
#: Of independent noise the best shift matches to 0.05, where it comes in large blocks to 0.35 at the most; of a picture
#: that scrolls by a quarter of itself to 0.65, and 1 is one that comes round again.
_MATCHES = 0.5
#: A picture stands still for so many steps before it is said to have frozen; where it stopped changing after this share
#: of the others' time, the last actions before may have done nothing.
_STILL, _NEARLY = 30, 0.9


class Observation(Check):
    name = "observation"
    rules = (
        Rule(
            "EC401",
            "constant",
            "The observation never changes, or no more from some step on.",
            "Draw the frame after the state has changed.",
        ),
        Rule(
            "EC402", "noise", "The observation is independent noise.", "Draw the state of the game, not random pixels."
        ),
        Rule("EC403", "unresponsive", "The observation does not react to actions.", "Draw what the agent controls."),
        Rule("EC404", "unlike-render", "The observation differs from render().", "Draw both by one method."),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [trace for trace in subject.played() if len(trace.observations) > 1]
        if not traces:
            raise Skip("no episode came to a second observation")
        longest = max(traces, key=lambda trace: trace.steps)
        subject.foresee(
            [self._watch(subject, subject.choices[0]), self._rendered(traces[0])][: 1 + subject.contract.render]
        )
        if _only_value(subject.observation_space):
            raise Skip("the observation space has one value only")
        if subject.contract.observation is None and longest.steps == 1:
            raise Skip("every episode is a single decision, after which nobody looks")
        seen = [trace for trace in traces if not trace.opaque]
        if len(seen) == len(traces) and all(len(set(trace.observations)) == 1 for trace in traces):
            yield self.finding(
                "EC401",
                f"no picture changes during any of {len(traces)} episodes, "
                f"{sum(trace.steps for trace in traces)} steps in all",
                line=subject.line_of("step"),
                repro=repro(longest.rollout.cut(20)),
            )
        elif (noise := self._find_noise(subject)) is not None:
            yield noise
        elif (unmoved := self._find_unresponsive(subject, seen)) is not None:
            yield unmoved
        elif (frozen := self._find_frozen(subject, seen)) is not None:
            yield frozen
        yield from self._find_unlike_render(subject, traces[0])
        if len(seen) < len(traces):
            raise Skip(
                "not all of its observations can be looked into: of types that only its package knows, or too large"
            )

    def _find_noise(self, subject: Subject) -> Finding | None:
        if not _pictures(subject.observation_space):
            return None
        watched = []
        for action in (subject.choices[0], subject.choices[-1]):
            rollout = self._watch(subject, action)
            trace = subject.rollout(rollout)
            measured = noise(trace.frames)
            if measured is None or not measured[0]:
                return None
            watched.append((rollout, measured))
        rollout, (_, changing, correlation) = watched[0]
        return self.finding(
            "EC402",
            f"{changing:.0%} of the picture changes at each step and has nothing to do with the steps before "
            f"(correlation {correlation:.2f} at most)",
            line=subject.line_of("step"),
            repro=repro(rollout),
            changing=changing,
            correlation=correlation,
        )

    def _watch(self, subject: Subject, action: Any) -> Rollout:
        return Rollout(subject.episode_seed(0), [action] * _WATCHED, player=f"holding {action}", keep=_WATCHED)

    def _rendered(self, play: Trace) -> Rollout:
        return play.rollout.cut(_RENDERED).under(Conditions(render=True))

    def _find_unresponsive(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        compared, longest = 0, None
        by_seed: dict[int, list[Trace]] = {}
        for trace in traces:
            by_seed.setdefault(trace.rollout.seed, []).append(trace)
        for same in by_seed.values():
            for trace in same[1:]:
                if trace.rollout.actions == same[0].rollout.actions:
                    continue
                if any(one != two for one, two in zip(same[0].observations, trace.observations, strict=False)):
                    return None
                if subject.contract.observation is None and _paid_apart(same[0], trace):
                    # As in a bandit, or where something is to be remembered: the reward tells what was done.
                    return None
                compared += 1
                longest = trace if longest is None or trace.steps > longest.steps else longest
        if compared < 3 or longest is None or longest.steps < 2:
            return None
        return self.finding(
            "EC403",
            f"under the same seed the pictures are the same whatever is done ({compared} comparisons, "
            f"up to {longest.steps} steps)",
            line=subject.line_of("step"),
            repro=repro(longest.rollout.cut(longest.steps)),
            compared=compared,
        )

    def _find_frozen(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        if not _pictures(subject.observation_space) or not traces:
            return None
        last = max(map(_last_change, traces))
        long = [trace for trace in traces if trace.usable and trace.steps >= max(2 * last, last + _STILL)]
        # An idle player may well have seen the end of all motion before.
        busy = [trace for trace in long if len({str(action) for action in trace.actions[last : trace.steps]}) > 1]
        frozen = [trace for trace in busy if _last_change(trace) == last]
        if len(frozen) < 4 or 2 * len(frozen) < len(busy) or len({trace.rollout.seed for trace in frozen}) < 2:
            return None
        if any(_last_change(trace) < _NEARLY * last for trace in busy):
            return None
        others = [*subject.rollouts(subject.players.rotations), *subject.searches.explored()]
        if any(trace.opaque or _last_change(trace) > last for trace in others):
            return None
        longest = max(frozen, key=lambda trace: trace.steps)
        return self.finding(
            "EC401",
            f"the picture freezes: after step {last} it changes in none of {len(traces) + len(others)} episodes, up to "
            f"step {longest.steps}",
            line=subject.line_of("step"),
            repro=repro(longest.rollout.cut(longest.steps)),
            step=last,
            episodes=len(frozen),
        )

    def _find_unlike_render(self, subject: Subject, play: Trace) -> Iterator[Finding]:
        if not subject.contract.render:
            return
        rollout = self._rendered(play)
        trace = subject.rollout(rollout)
        differing = [problem for problem in trace.render_problems if problem.kind == "differs"]
        # An observation that fails the contract's type is api's finding, not a disagreement of two good pictures.
        bad = {problem.step for problem in trace.problems}
        differing = [problem for problem in differing if problem.step not in bad]
        if differing:
            step = differing[0].step
            at = "the reset" if step == 0 else f"step {step}"
            yield self.finding(
                "EC404",
                f"after {at} render() gives another picture than the observation",
                line=subject.line_of("render"),
                repro=repro(rollout.cut(step)),
                step=step,
            )


def _last_change(trace: Trace) -> int:
    """The step that changed the observation for the last time; 0 where none did."""
    changes = (step for step in range(len(trace.observations) - 1, 0, -1) if _changed(trace, step))
    return next(changes, 0)


def _changed(trace: Trace, step: int) -> bool:
    return trace.observations[step] != trace.observations[step - 1]


def _paid_apart(one: Trace, two: Trace) -> bool:
    return any(first != second for first, second in zip(one.rewards, two.rewards, strict=False))


def _pictures(space: dict[str, Any]) -> bool:
    """Whether observations are pictures: a few numbers may well be drawn anew at each step, as in a bandit."""
    return bool(space["type"] == "Box" and len(space["shape"]) >= 2 and space["dtype"] == "uint8")


def _only_value(space: dict[str, Any]) -> bool:
    if space["type"] == "Box":
        return bool(space["low"] == space["high"] and space["low"] is not None) and not isinstance(space["low"], list)
    return bool(space["type"] == "Discrete" and space["n"] == 1)


def noise(frames: Sequence[Any]) -> tuple[bool, float, float] | None:
    """Whether frames are independent in time: the verdict, the share of values that change, the highest correlation.

    `frames` are arrays of one shape. None with too few of them to say.
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
    """Whether most pictures are the one before, moved: each pair has one shift by which it matches.

    By phase correlation (Kuglin and Hines, "The phase correlation image alignment method", 1975): of independent noise
    no shift stands out, and what does not move at all is not counted.
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
