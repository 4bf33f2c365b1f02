"""Pictures that stop changing after some step or event, while the game goes on."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from .traces import Defect, changed, shows_pictures

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: Steps without a change before a picture counts as frozen. If it stopped changing before this share of the last change
#: of the others, its last actions may have had no effect.
_STILL, _NEARLY = 30, 0.9
#: Episodes that must freeze, and those that must freeze at an event.
_FROZEN, _AT_EVENT = 4, 3
#: The most common rewards that may freeze a picture, and the share of steps before that must change it.
_KINDS, _LIVELY = 5, 0.1
#: Steps after the last change at which moves are tried, and the fewest states that they lead to.
_WAIT, _LASTING = 5, 3
#: The most episodes that go on from a state which a search found, and the fewest steps of all together.
_PLAYED, _SHOWN = 16, 60
_ORDINALS = ("first", "second", "third")


def find_frozen(subject: Subject, traces: list[Trace]) -> Defect | None:
    """Find a picture that stops at one step of all episodes, or at an event of some, or where only a search came."""
    return _find_at_step(subject, traces) or _find_at_event(subject, traces) or _find_in_search(subject)


def _find_at_step(subject: Subject, traces: list[Trace]) -> Defect | None:
    if not shows_pictures(subject.observation_space) or not traces:
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
    return Defect(
        f"the picture freezes: it does not change after step {last} in any of {len(traces) + len(others)} "
        f"episodes, up to step {longest.steps}",
        longest.rollout.cut(longest.steps),
        {"step": last, "episodes": len(frozen)},
    )


def _find_at_event(subject: Subject, traces: list[Trace]) -> Defect | None:
    if not shows_pictures(subject.observation_space) or not any(map(_stops, [*traces, *subject.searches.onward])):
        return None
    more = [*subject.episodes.rotations, *subject.searches.explored(), *subject.searches.onward]
    if sum(map(_stops, traces)) < _AT_EVENT:
        more += itertools.islice(subject.episodes.more_whole(), _AT_EVENT)
    known = {trace.rollout.key(): trace for trace in [*traces, *more] if trace.usable and not trace.opaque}
    traces = list(known.values())
    stopped = [trace for trace in traces if _stops(trace)]
    if len(stopped) < _AT_EVENT:
        return None
    words, frozen = _at_reward(traces) or ("", stopped)
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
    return Defect(
        f"the picture freezes{words}: it stops changing in {len(frozen)} episodes, for example from step {last} "
        f"to step {first.steps}, although the game goes on",
        first.rollout.cut(first.steps),
        {"step": last, "episodes": len(frozen)},
    )


def _find_in_search(subject: Subject) -> Defect | None:
    """Find a state of an exploration after which no play changes the picture, though moves lead to different states."""
    from envcraft.judging import actions
    from envcraft.model.rollout import Rollout

    if not shows_pictures(subject.observation_space):
        return None
    for number, outcome in enumerate(subject.searches.explorations):
        path, seed = outcome.get("still") or [], subject.episode_seed(number)
        if not path or not subject.affords(_FROZEN * (len(path) + _SHOWN)):
            continue
        traces: list[Trace] = []
        shown = 0
        for at, draw in zip(range(_PLAYED), itertools.cycle((actions.random_actions, actions.sticky_actions))):
            later = draw(subject.action_space, seed + at, _SHOWN)
            traces.append(subject.rollout(Rollout(seed, path + later, player="play after an exploration")))
            shown += max(traces[-1].steps - len(path), 0)
            enough = len(traces) >= _FROZEN and shown >= _SHOWN
            if enough or not _stays(traces[-1], len(path)) or not subject.affords(len(path) + _SHOWN):
                break
        if not enough or not all(_stays(trace, len(path)) for trace in traces) or not _lively(traces):
            continue
        if subject.searches.hidden_states(path, seed) >= _LASTING:
            last = _last_change(traces[0])
            return Defect(
                f"the picture freezes: after step {last} it does not change in {len(traces)} episodes that go on from "
                f"there, {shown} steps in all, although moves lead to different states of the game",
                max(traces, key=lambda trace: trace.steps).rollout,
                {"step": last, "episodes": len(traces)},
            )
    return None


def _stays(trace: Trace, start: int) -> bool:
    """Whether an episode goes on after a step, and its picture does not change from there on."""
    return trace.usable and not trace.opaque and trace.steps > start and _last_change(trace) <= start


def _at_reward(traces: list[Trace]) -> tuple[str, list[Trace]] | None:
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


def _stops(trace: Trace) -> bool:
    """Whether a picture changes no more from some step on, under varied actions."""
    last = _last_change(trace)
    if not trace.usable or trace.steps < last + _STILL:
        return False
    return len({str(action) for action in trace.actions[last : trace.steps]}) > _AT_EVENT


def _lively(traces: list[Trace]) -> bool:
    """Whether pictures change before their last change."""
    changes = [changed(trace, step) for trace in traces for step in range(1, _last_change(trace) + 1)]
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


def _last_change(trace: Trace) -> int:
    """The last step that changed the observation; 0 if none did."""
    changes = (step for step in range(len(trace.observations) - 1, 0, -1) if changed(trace, step))
    return next(changes, 0)
