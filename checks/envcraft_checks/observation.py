"""# observation

## What it does
Checks that the observation carries information. It must change in some episode. It must not be independent noise. The
same seed under different actions must lead to different observations. `render()` must return the observation if the
contract requires it, or makes it optional and there is one. A picture that changes only when the agent acts, or
changes rarely, is fine.

A picture is frozen if it changes for the last time at the same step in episodes of several seeds and policies, and at
least half of each of these episodes follows that step. No other play may change it later: held actions, all actions in
rotation, or exploration. A game that gets stuck does so at different steps, and a game that waits for the right action
receives it from some policy. A picture is also frozen if it changes at first, and no more after some step or reward of
at least three episodes, while the game goes on: the same action is then paid differently at the same picture, or a
search finds that moves there lead to different states that look the same. A game that is over, or stuck, is neither.

The contrast is too low if no channel of any picture spans more than eight of 255 levels. A dark game has some bright
pixel, and a game that begins in the dark shows one later. Small pictures may hold codes instead of colours, and so may
grey ones that no contract prescribes.

An agent is invisible if no picture of episodes that each hold one move differs before their rewards and flags do,
although moves lead to at least three lasting states of the game, or, if episodes do nothing after their first moves, to
three different rewards or endings; two are a warning. A move that shows late, or matters only while it is pressed, is
fine.

State is hidden (a warning) if three quarters of all rewards and terminations follow a picture and an action that had
another result elsewhere, and the picture does not make the event likelier, in a game that draws no random numbers while
it is played. Memory games are like that on purpose.

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
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import Rollout
from envcraft.model.verdict import Finding, Severity
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
#: Episodes that must freeze, and those that must freeze at an event.
_FROZEN, _AT_EVENT = 4, 3
#: The most common rewards that may freeze a picture, and the share of steps before that must change it.
_KINDS, _LIVELY = 5, 0.1
#: Steps after the last change at which moves are tried, and the fewest states that they lead to.
_WAIT, _LASTING = 5, 3
#: The widest range of a channel whose contrast is too low, in levels, and the shortest side of a picture in pixels.
_FAINT, _SIDE = 8, 32
#: The fewest events that follow from hidden state, their share of all, and how much likelier a picture may make one.
_HIDDEN, _MOST, _TOLD = 10, 0.75, 2
#: Steps of a move that is held, steps of the episode, and the most moves.
_MOVED, _WAITED, _MOVES = 8, 120, 6


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
        Rule(
            "EC405",
            "low-contrast",
            "The values of the picture span almost nothing.",
            "Scale colours to 0 to 255 before they are cast to uint8.",
        ),
        Rule(
            "EC406",
            "hidden-state",
            "The same action at the same picture is paid differently.",
            "Draw what decides about the reward, such as a timer or a direction.",
            Severity.WARNING,
        ),
        Rule(
            "EC407",
            "agent-invisible",
            "Moves matter, but no picture shows them.",
            "Draw what the agent controls where it is.",
        ),
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
        elif (faint := self._find_faint(subject)) is not None:
            yield faint
        elif (noise := self._find_noise(subject)) is not None:
            yield noise
        elif (unmoved := self._find_unresponsive(subject, seen)) is not None:
            yield unmoved
        elif (invisible := self._find_invisible(subject)) is not None:
            yield invisible
        elif (frozen := self._find_frozen(subject, seen) or self._find_frozen_later(subject, seen)) is not None:
            yield frozen
        elif (hidden := self._find_hidden(subject, seen)) is not None:
            yield hidden
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
        others = [*subject.episodes.rotations, *subject.episodes.more_held(last + _STILL)]
        others += [*subject.searches.explored(), *subject.searches.onward]
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

    def _find_frozen_later(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        """Find a picture that stops at an event of the episode, while the game goes on."""
        if not _pictures(subject.observation_space) or not any(map(_stops, [*traces, *subject.searches.onward])):
            return None
        more = [*subject.episodes.rotations, *subject.searches.explored(), *subject.searches.onward]
        if sum(map(_stops, traces)) < _AT_EVENT:
            more += itertools.islice(subject.episodes.more_whole(), _AT_EVENT)
        known = {trace.rollout.key(): trace for trace in [*traces, *more] if trace.usable and not trace.opaque}
        traces = list(known.values())
        stopped = [trace for trace in traces if _stops(trace)]
        if len(stopped) < _AT_EVENT:
            return None
        words, frozen = self._at_reward(traces) or ("", stopped)
        if not _lively(frozen):
            return None
        if sum(map(_goes_on, frozen)) < _AT_EVENT or not words:
            # The rewards do not show that the game goes on, so its state must.
            for trace in sorted(frozen, key=_last_change)[:_AT_EVENT]:
                path = trace.actions[: _last_change(trace) + _WAIT]
                if not subject.affords(2 * len(path)):
                    return None
                if subject.searches.hidden_states(path, trace.rollout.seed) < _LASTING:
                    return None
        first = min(frozen, key=_last_change)
        last = _last_change(first)
        return self.finding(
            "EC401",
            f"the picture freezes{words}: it changes no more in {len(frozen)} episodes, in one from step {last} "
            f"to step {first.steps}, although the game goes on",
            line=subject.line_of("step"),
            repro=repro(first.rollout.cut(first.steps)),
            step=last,
            episodes=len(frozen),
        )

    def _at_reward(self, traces: list[Trace]) -> tuple[str, list[Trace]] | None:
        """The reward at which the pictures of all episodes stop, in words, and these episodes."""
        counts = Counter(reward for trace in traces for reward in trace.rewards)
        usual, *others = [reward for reward, _ in counts.most_common(_KINDS)]
        kinds = [(f"{reward:g}", {reward}) for reward in others]
        kinds.append((f"more than {usual:g}", {reward for reward in counts if reward > usual}))
        kinds.append((f"less than {usual:g}", {reward for reward in counts if reward < usual}))
        for (words, kind), number in itertools.product(kinds, range(len(_ORDINALS))):
            events = [(trace, step) for trace in traces if (step := _event(trace, kind, number))]
            frozen = [trace for trace, _ in events if _stops(trace)]
            late = any(_last_change(trace) > step + 1 for trace, step in events)
            if len(frozen) >= _AT_EVENT and not late and _lively(frozen):
                return f" at the {_ORDINALS[number]} reward of {words}", frozen
        return None

    def _find_faint(self, subject: Subject) -> Finding | None:
        """Find pictures without contrast: first in those of the fingerprint, then in all of two episodes."""
        from envcraft.spaces.spec import Box

        space, promised = subject.observation_space, subject.contract.observation is not None
        if not _pictures(space) or not isinstance(space, Box) or not space.spans_dtype:
            return None
        if not promised and (len(space.shape) != 3 or space.shape[2] != 3 or min(space.shape[:2]) < _SIDE):
            return None
        known = next((trace for trace in subject.traces if trace.ranges), None)
        if known is None or _span(known.ranges) > _FAINT:
            return None
        best = subject.searches.best()
        traces = [known]
        for trace in [subject.episodes.whole[0], *([best] if best is not None else [])]:
            if trace.usable and subject.affords(trace.steps):
                traces.append(subject.rollout(_kept(trace)))
        spans = [_span(known.ranges), *(_span(_ranges(trace.frames)) for trace in traces[1:])]
        if max(spans) > _FAINT:
            return None
        finding = self.finding(
            "EC405",
            f"the values of the picture span at most {max(spans)} of 255 levels in {len(traces)} episodes, up to step "
            f"{max(trace.steps for trace in traces)}",
            line=subject.line_of("step"),
            repro=repro(known.rollout.cut(20)),
            span=max(spans),
        )
        return finding if promised else finding.as_warning()

    def _find_invisible(self, subject: Subject) -> Finding | None:
        """Find moves that no picture shows before they are paid."""
        if not _pictures(subject.observation_space):
            return None
        moves = _simple_moves(subject)
        held = [trace for trace in subject.held() if trace.rollout.actions[0] in moves and not trace.opaque]
        if len(held) < _AT_EVENT or _first_apart(held) == "seen":
            return None
        states = subject.searches.hidden_states([], subject.episode_seed(0))
        if states >= _LASTING:
            longest = max(held, key=lambda trace: trace.steps)
            return self.finding(
                "EC407",
                f"moves lead to {states} states of the game with the same pictures, and no picture of {len(held)} "
                f"episodes that hold one move differs before its rewards and flags do, up to step {longest.steps}",
                line=subject.line_of("step"),
                repro=repro(longest.rollout.cut(longest.steps)),
                states=states,
                compared=len(held),
            )
        return self._find_paid_unseen(subject, moves) if _first_apart(held) == "paid" else None

    def _find_paid_unseen(self, subject: Subject, moves: list[Any]) -> Finding | None:
        """Find moves that rewards or endings show later, and no picture before them."""
        length = min(_WAITED, subject.length)
        if not subject.affords(length * len(moves)):
            return None
        rest = [moves[0]] * (length - _MOVED)
        words = "doing nothing" if moves[0] == subject.contract.noop else f"holding {moves[0]}"
        rollouts = [
            Rollout(subject.episode_seed(0), [move] * _MOVED + rest, player=f"{_MOVED} times {move}, then {words}")
            for move in moves
        ]
        traces = [trace for trace in subject.rollouts(rollouts) if trace.usable and trace.steps > _MOVED]
        if _first_apart(traces) != "paid":
            return None
        # Episodes that are paid apart during the moves may be paid for the moves themselves.
        early: dict[tuple[Any, ...], list[Trace]] = defaultdict(list)
        for trace in traces:
            early[*trace.rewards[:_MOVED], *trace.observations[: _MOVED + 1]].append(trace)
        same = max(early.values(), key=len)
        outcomes = {_outcome(trace, _MOVED): trace for trace in same}
        if len(outcomes) < 2:
            return None
        shown = min(outcomes.values(), key=lambda trace: trace.steps)
        differing = " or ".join(str(trace.rollout.actions[0]) for trace in outcomes.values())
        finding = self.finding(
            "EC407",
            f"{_MOVED} times {differing}, then {words}: rewards and endings differ {len(outcomes)} ways within "
            f"{length} steps, but no picture differs before",
            line=subject.line_of("step"),
            repro=repro(shown.rollout.cut(shown.steps)),
            outcomes=len(outcomes),
            compared=len(same),
        )
        return finding if len(outcomes) > 2 else finding.as_warning()

    def _find_hidden(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        """Find state that is not drawn and decides about most rewards, where chance does not."""
        outcomes = subject.searches.explorations
        if not _pictures(subject.observation_space) or any(outcome.get("stochastic", True) for outcome in outcomes):
            return None
        by_picture: dict[tuple[bytes, str], Counter[tuple[float, bool]]] = defaultdict(Counter)
        by_action: dict[str, Counter[tuple[float, bool]]] = defaultdict(Counter)
        for trace in traces:
            for step in range(trace.steps):
                action, result = str(trace.actions[step]), (trace.rewards[step], trace.terminated[step])
                by_picture[trace.observations[step], action][result] += 1
                by_action[action][result] += 1
        every: Counter[tuple[float, bool]] = sum(by_action.values(), Counter())
        usual = every.most_common(1)[0][0]
        events = every.total() - every[usual]
        hidden = 0
        for (_, action), counts in by_picture.items():
            whole = by_action[action]
            for result, count in counts.items():
                # A picture tells something of a result that follows it more often than other pictures.
                told = count >= _TOLD * counts.total() * whole[result] / whole.total()
                hidden += count if len(counts) > 1 and result != usual and not told else 0
        if hidden < _HIDDEN or hidden < _MOST * events:
            return None
        return self.finding(
            "EC406",
            f"no picture tells when {hidden} of {events} events come, rewards other than {usual[0] + 0.0:g} and "
            "terminations: the same action at the same picture had another result elsewhere, although the game draws "
            "no random numbers while it is played",
            line=subject.line_of("step"),
            repro=repro(traces[0].rollout.cut(traces[0].steps)),
            hidden=hidden,
            events=events,
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


_ORDINALS = ("first", "second", "third")


def _stops(trace: Trace) -> bool:
    """Whether a picture changes no more from some step on, under varied actions."""
    last = _last_change(trace)
    if not trace.usable or trace.steps < last + _STILL:
        return False
    return len({str(action) for action in trace.actions[last : trace.steps]}) > _AT_EVENT


def _lively(traces: list[Trace]) -> bool:
    """Whether pictures change before their last change."""
    changes = [_changed(trace, step) for trace in traces for step in range(1, _last_change(trace) + 1)]
    return sum(changes) >= max(_LIVELY * len(changes), _AT_EVENT)


def _goes_on(trace: Trace) -> bool:
    """Whether some action is paid differently after the last change of the picture."""
    last = _last_change(trace)
    paid: dict[str, set[float]] = defaultdict(set)
    # The reward of the last change may belong to the event.
    for action, reward in zip(trace.actions[last + 1 : trace.steps], trace.rewards[last + 1 :], strict=True):
        paid[str(action)].add(reward)
    return any(len(rewards) > 1 for rewards in paid.values())


def _event(trace: Trace, kind: set[float], number: int) -> int | None:
    """The step of a reward of some kind if some time follows it; `number` 0 is the first such reward."""
    events = (step for step, reward in enumerate(trace.rewards, 1) if reward in kind)
    step = next(itertools.islice(events, number, None), None)
    return step if step is not None and trace.steps >= step + _STILL else None


def _simple_moves(subject: Subject) -> list[Any]:
    """The actions that differ from the first one, or from doing nothing, in one component only, the same for all."""
    joint = subject.joint_actions
    if not isinstance(joint[0], list):
        return joint[:_MOVES]
    by_place: dict[int, list[Any]] = defaultdict(list)
    for action in joint[1:]:
        differing = [at for at, (one, other) in enumerate(zip(action, joint[0], strict=True)) if one != other]
        if len(differing) == 1:
            by_place[differing[0]].append(action)
    return [joint[0], *max(by_place.values(), key=len, default=[])][:_MOVES]


def _first_apart(traces: list[Trace]) -> str:
    """How the traces of one seed first differ.

    Returns:
        ``seen`` if pictures of two differ before their rewards and flags do, and not by an event that is paid alike;
        ``paid`` if no pictures do and rewards or flags of some differ; else nothing.
    """
    apart = ""
    usual = Counter(reward for trace in traces for reward in trace.rewards).most_common(1)
    for one, two in itertools.combinations(traces, 2):
        for step in range(min(one.steps, two.steps)):
            if one.observations[step] != two.observations[step]:
                return "seen"
            results = {_result(one, step), _result(two, step)}
            # Two events may be paid alike.
            alike = one.rewards[step] != usual[0][0] and one.observations[step + 1] != two.observations[step + 1]
            if len(results) > 1 or alike:
                apart = "paid"
                break
    return apart


def _result(trace: Trace, step: int) -> tuple[float, bool, bool]:
    return trace.rewards[step], trace.terminated[step], trace.truncated[step]


def _outcome(trace: Trace, start: int) -> tuple[Any, ...]:
    return trace.steps, *trace.rewards[start:]


def _kept(trace: Trace) -> Rollout:
    """The same episode with its frames."""
    return msgspec.structs.replace(trace.rollout.cut(trace.steps), keep=trace.steps + 1)


def _span(ranges: list[tuple[int, int]]) -> int:
    return max((high - low for low, high in ranges), default=0)


def _ranges(frames: Sequence[Any]) -> list[tuple[int, int]]:
    """The lowest and highest value of each channel of some pictures."""
    shown = [frame for frame in frames if frame.ndim == 3]
    if len(shown) < len(frames) or len({frame.shape for frame in frames}) != 1:
        return [(int(frame.min()), int(frame.max())) for frame in frames if frame.size]
    channels = range(shown[0].shape[2])
    return [
        (min(int(frame[..., at].min()) for frame in shown), max(int(frame[..., at].max()) for frame in shown))
        for at in channels
    ]


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
