"""Many seeds, and resets without a seed: episodes that must be equal, and those that must differ."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec

from envcraft.judging.shrink import repro
from envcraft.model.rollout import Conditions, Episode, Rollout
from envcraft_checks.comparing.causes import TELEMETRY, Cause, by_reading, code_of, fewer_episodes
from envcraft_checks.comparing.conditions import OTHER_STATE, SHIFTED
from envcraft_checks.comparing.traces import diverge
from envcraft_checks.linting.generators import anew, constant_seed
from envcraft_checks.linting.program import Suspect, in_words, program_of

if TYPE_CHECKING:
    from envcraft.judging.check import Check
    from envcraft.judging.subject import Subject
    from envcraft.model.verdict import Finding

#: Seeds that are played once more under other conditions.
_MORE_SEEDS = 8
#: For resets without a seed: steps of an episode, repetitions of the first, and episodes that must be equal for EC212.
_UNSEEDED_STEPS, _UNSEEDED_AGAIN, _UNSEEDED = 10, 2, 8
#: Steps after which seeds are compared first.
_SEEDED_STEPS = 20


def after_many(subject: Subject) -> Iterator[tuple[Rollout, Cause]]:
    """Compare what the session repeats with the same episode in a process of its own."""
    last = subject.session.trace
    plain = last.rollout.under(Conditions())
    subject.rollout(plain, alone=True)
    before = [Episode(episode.seed, episode.actions) for episode in last.rollout.conditions.before]
    repeated = [(number, last.before[number]) for number in subject.session.repetitions]
    for info in (True, False):
        # Consecutive episodes also show what every second reset undoes.
        differing = (
            number
            for number, trace in [*repeated, (len(last.before), last)]
            if diverge(subject.rollout(plain.cut(len(trace.rollout.actions)), alone=True), trace, info) is not None
        )
        if (number := next(differing, None)) is None:
            return
        short = plain if number == len(last.before) else plain.cut(len(before[number].actions))
        base = subject.rollout(short, alone=True)
        under = Conditions(before=before[:number])
        found = diverge(base, subject.rollout(short.under(under), alone=True), info)
        if found is None:
            return
        cause = by_reading(subject, short.cut(found.step), info)
        if cause is None:
            code = code_of(subject, "EC206", found)
            cause = Cause(code, *fewer_episodes(subject, short, base, under, found, info))
        yield short, cause
        if cause.code not in TELEMETRY.values():
            return


def differing(subject: Subject, info: bool) -> Rollout | None:
    """Play some seeds of the session once more, with other global generators and another clock.

    A level that few seeds have may draw from these, and the first seeds may not have it.

    Returns:
        The first episode that differs, for a comparison by condition; None if none does.
    """
    varied = subject.session.varied[:_MORE_SEEDS]
    if not varied:
        return None
    episodes = [Episode(trace.rollout.seed, trace.rollout.actions) for trace in varied]
    under = Conditions(before=episodes, recorded=True, global_seed=OTHER_STATE, clock=SHIFTED)
    again = subject.rollout(varied[0].rollout.cut(0).under(under)).before
    pairs = zip(varied, again, strict=False)
    return next((one.rollout.under(Conditions()) for one, two in pairs if diverge(one, two, info)), None)


def ignored(check: Check, subject: Subject) -> Iterator[Finding]:
    """Find an environment whose seeds all give the same episode."""
    first = subject.probes.random(0)
    # Most seeds differ at once.
    for length in (_SEEDED_STEPS, subject.budget.probes[1]):
        seeds = [subject.probes.episode_seed(number) for number in range(3)]
        same = [msgspec.structs.replace(first.cut(length), seed=seed) for seed in seeds]
        traces = subject.rollouts(same)
        if any(diverge(traces[0], trace, info=False) is not None for trace in traces[1:]):
            return
    if not any(trace.opaque for trace in traces):
        fixed = _constant_seed(subject)
        why = f"; {in_words([fixed])[0]}" if fixed is not None and fixed.certain else ""
        yield check.finding(
            "EC209",
            f"the seeds {seeds} give the same frames, rewards and flags, which is fine for one fixed level{why}",
            line=fixed.line if fixed is not None else subject.line_of("reset"),
            repro=repro(same[0].cut(20)),
            seeds=seeds,
        )


def _constant_seed(subject: Subject) -> Suspect | None:
    program = program_of(subject)
    return constant_seed(program) if program is not None else None


def _rendered(check: Check, subject: Subject, rollout: Rollout) -> Iterator[Finding]:
    """Judge whether render() changes what the unseeded reset after an episode gives, as a recorded video would."""
    if not subject.renders:
        return
    under = msgspec.structs.replace(rollout.conditions, render=True)
    shown = rollout.under(under)
    if diverge(subject.rollout(rollout), subject.rollout(shown), info=False) is None:
        return
    found = diverge(subject.rerun(rollout), again := subject.rerun(shown), info=False)
    if found is not None and again.fault is None:
        words = f"after reset(seed={rollout.conditions.before[0].seed}) and an episode, reset() gives another episode"
        yield check.finding(
            "EC208",
            f"{words} with render() between the steps: {found}",
            line=subject.line_of("render"),
            repro=repro(shown.cut(found.step)),
            step=found.step,
        )


def unseeded(check: Check, subject: Subject, fixed: bool) -> Iterator[Finding]:
    """Judge unseeded episodes that follow a seeded one. `fixed` says that all seeds give the same episode."""
    plain = subject.probes.random(0).cut(_UNSEEDED_STEPS)

    def after(count: int) -> Rollout:
        before = [Episode(plain.seed, plain.actions), *[Episode(None, plain.actions)] * count]
        return plain.under(Conditions(before=before, unseeded=True))

    first = subject.rollout(after(0))
    if first.opaque or not first.usable:
        return
    again = (subject.rerun(after(0), alone=False) for _ in range(_UNSEEDED_AGAIN))
    if any(diverge(first, trace, info=False) is not None for trace in again):
        alone = subject.rerun(after(0))
        if (found := diverge(alone, subject.rerun(after(0)), info=False)) is not None:
            words = f"after reset(seed={plain.seed}) and an episode, reset() gives another episode in each run: {found}"
            small = repro(after(0).cut(found.step))
            program = program_of(subject)
            cause = anew(program) if program is not None else None
            words += f"; {in_words([cause])[0]}" if cause is not None else ""
            line = cause.line if cause is not None else subject.line_of("reset")
            yield check.finding("EC213", words, line=line, repro=small, step=found.step)
            return
    yield from _rendered(check, subject, after(0))
    later = (subject.rollout(after(count)) for count in range(1, _UNSEEDED + 1))
    if fixed or not all(diverge(first, trace, info=False) is None for trace in later):
        return
    # On an instance made in the same way: a constructor may draw what differs.
    follows = plain.under(Conditions(before=[Episode(plain.seed, plain.actions)], global_seed=plain.seed % 2**32))
    seeded = [msgspec.structs.replace(follows, seed=subject.probes.random(number).seed) for number in range(_UNSEEDED)]
    traces = subject.rollouts(seeded)
    different = sum(diverge(traces[0], trace, info=False) is not None for trace in traces)
    seeding = _constant_seed(subject)
    # Equal episodes may be chance where few are different, unless the code chooses the seed.
    if 2 * different > _UNSEEDED or (seeding is not None and different > 1):
        words = f"after reset(seed={plain.seed}) all {_UNSEEDED + 1} resets without a seed give the same episode, "
        words += f"while {_UNSEEDED} seeds give {different + 1} different ones"
        line = seeding.line if seeding is not None else subject.line_of("reset")
        yield check.finding("EC212", words, line=line, repro=repro(after(1)))
