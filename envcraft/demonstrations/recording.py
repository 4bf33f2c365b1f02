"""Recording: players play the environments of a corpus in the sandbox, side by side, and each recording is written down
as it comes; and playing again what was recorded, to hold it against the recording or to have its frames.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

import msgspec

from envcraft.budget import BUDGETS
from envcraft.check import Check, Rule, Skip
from envcraft.contract import Contract
from envcraft.corpus.audit import stored
from envcraft.corpus.settings import contract_digest
from envcraft.corpus.store import Environment, Store
from envcraft.demonstrations import cache, keeping
from envcraft.demonstrations.form import Recorder, Recording, difference
from envcraft.demonstrations.player import Player
from envcraft.engine import Plan, stream
from envcraft.events import Event, SubjectFinished
from envcraft.pool import Pool
from envcraft.rollout import Rollout
from envcraft.sandbox import Driver, Limits
from envcraft.shrink import repro
from envcraft.subject import Subject
from envcraft.target import Target
from envcraft.trace import Trace, diverge
from envcraft.verdict import Finding, SubjectReport, Verdict

#: All of an environment's episodes together may take an hour for so many steps.
_HOUR = 50_000
#: Steps that an episode may well have.
_LONGEST = 1_000
_BUDGET = BUDGETS["standard"]

Tell = Callable[[Event], None]


class _Playing(Check):
    """Has a player play; what its policy must not do are findings."""

    name = "demonstrations"
    rules = (
        Rule(
            "EC804",
            "policy-writes",
            "The privileged policy changes the environment.",
            "Read the state, change nothing.",
        ),
        Rule("EC805", "policy-fails", "The privileged policy raises or chooses no valid action.", "Mend the policy."),
    )

    def __init__(self, player: Player) -> None:
        self._player = player

    def _episode(self, subject: Subject, number: int) -> Trace | Finding:
        """The player's episode with this number, of actions from a list, or what was wrong. Raises Skip where it breaks
        off.
        """
        trace = self._player.play(subject, number)
        wrong = self._wrong(trace)
        if wrong is None and trace.rollout.live:
            # What a policy played counts as what its actions give without it.
            plain = subject.rollout(Rollout(trace.rollout.seed, trace.actions, player="the player's actions"))
            if (found := diverge(trace, plain, info=False)) is not None:
                words = f"without the policy its actions give another trace: {found}"
                wrong = self.finding("EC804", words, repro=repro(plain.rollout.cut(found.step)), step=found.step)
            trace = plain
        if wrong is not None:
            return wrong
        if not trace.usable or not trace.steps:
            raise Skip(f"the episode on seed {trace.rollout.seed} breaks off: {trace.fault or trace.ending}")
        return trace

    def _wrong(self, trace: Trace) -> Finding | None:
        """What a policy did that it must not do."""
        at = trace.steps + 1
        if trace.refused:
            return self.finding("EC805", f"the policy's move {len(trace.chosen)} is refused: {trace.refused}")
        if trace.choosing and trace.end is not None:
            return self.finding("EC805", f"the policy does not choose move {at} ({trace.end.how}: {trace.end.detail})")
        fault = trace.fault
        if fault is None or not fault.phase.startswith("policy"):
            return None
        if fault.phase == "policy write" or fault.type.endswith("ReadOnlyState"):
            return self.finding("EC804", f"the policy writes to the environment at step {at}: {fault.message}")
        return self.finding("EC805", f"the policy raises {fault} at step {at}", line=fault.line)


class _Play(_Playing):
    """Has a player play until there are enough steps, and gives the recording to `take`."""

    def __init__(self, player: Player, steps: int, take: Callable[[str, Recorder], object]) -> None:
        super().__init__(player)
        self._steps, self._take = steps, take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        recorder = Recorder(self._steps)
        number = 0
        while recorder.left:
            trace = self._episode(subject, number)
            if isinstance(trace, Finding):
                yield trace
                return
            if trace.steps > recorder.left:
                trace = subject.rollout(trace.rollout.cut(recorder.left))
            recorder.add(trace)
            number += 1
        self._take(subject.target.path, recorder)


class _Count(_Playing):
    """Has a player play so many episodes, and gives what came out of them to `take`."""

    def __init__(self, player: Player, episodes: int, take: Callable[[str, list[keeping.Outcome]], object]) -> None:
        super().__init__(player)
        self._episodes, self._take = episodes, take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        outcomes = []
        for number in range(self._episodes):
            trace = self._episode(subject, number)
            if isinstance(trace, Finding):
                yield trace
                return
            outcomes.append(keeping.Outcome(trace.steps, trace.total, trace.success))
            subject.drop()
        self._take(subject.target.path, outcomes)


class _Replay(Check):
    """Plays every episode of a recording again: EC201 where something else comes out. With `take`, the frames are kept
    and given to it.
    """

    name = "demonstrations"
    rules = (
        Rule(
            "EC201", "run-again", "The same seed gives another trace when run again.", "Draw from self.np_random only."
        ),
    )

    def __init__(
        self, recordings: dict[str, list[Recording]], take: Callable[[Recording, bytes], object] | None = None
    ) -> None:
        self._recordings, self._take = recordings, take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        for recording in self._recordings.get(subject.target.path, ()):
            writer = cache.Writer(recording) if self._take is not None else None
            for number, episode in enumerate(recording.episodes):
                keep = episode.steps + 1 if writer is not None else 0
                rollout = Rollout(episode.seed, recording.actions(episode), player="the recorded actions", keep=keep)
                # Not remembered: with frames it is large, and nobody asks for it a second time.
                trace = subject.rerun(rollout)
                if found := difference(episode, trace):
                    words = (
                        f"the player {recording.player}'s episode {number} on seed {episode.seed} is another: {found}"
                    )
                    yield self.finding("EC201", words, repro=repro(rollout))
                    writer = None
                    break
                if writer is not None:
                    writer.add(episode, trace.frames)
            if writer is not None and self._take is not None:
                self._take(recording, writer.to_bytes())


class Outcome(msgspec.Struct):
    """What became of a run: environment reports that are no pass, and counts."""

    done: int = 0
    steps: int = 0
    bad: list[SubjectReport] = []


def record(
    store: Store,
    chosen: Sequence[Environment],
    player: Player,
    contract: Contract,
    driver: Driver,
    steps: int,
    seed: int = 0,
    workers: int | None = None,
    tell: Tell | None = None,
) -> Outcome:
    """Have `player` play `steps` steps in each environment that has no such recording yet, and write them down.

    Raises OSError, and what the sandbox raises.
    """
    digest = contract_digest(contract)
    pending = []
    for environment in chosen:
        row = keeping.known(store, *environment[1:], digest, player.name, player.digest, seed)
        if row is None or row.steps < steps:
            pending.append(environment)
    made: dict[str, Recorder] = {}
    outcome = Outcome()
    check = _Play(player, steps, made.__setitem__)
    targets = stored(store, pending)
    for number, report in _run(targets, contract, driver, check, steps, seed, player, workers, tell):
        environment = pending[number]
        recorder = made.pop(environment.name, None)
        if recorder is None:
            outcome.bad.append(report)
            continue
        recording = recorder.recording(
            source=environment.source,
            env_class=environment.env_class,
            contract=contract.name,
            contract_sha256=digest,
            player=player.name,
            player_digest=player.digest,
            seed=seed,
        )
        keeping.keep(store, recording)
        outcome.done += 1
        outcome.steps += recording.steps
    return outcome


def replay(
    store: Store,
    named: Sequence[tuple[str, keeping.Row]],
    contract: Contract,
    driver: Driver,
    frames: bool,
    workers: int | None = None,
    tell: Tell | None = None,
) -> Outcome:
    """Play recordings again, and with `frames` write their caches, those that are missing. An environment whose frames
    cannot be kept is told among what went wrong.

    Raises OSError, CorpusDamaged, and what the sandbox raises.
    """
    recordings: dict[str, list[Recording]] = {}
    environments: dict[str, Environment] = {}
    files: dict[int, str] = {}
    for name, row in named:
        if frames and keeping.cache_place(store, row.file).exists():
            continue
        recording = keeping.read(store, row)
        recordings.setdefault(name, []).append(recording)
        environments[name] = Environment(name, row.source, row.env_class)
        files[id(recording)] = row.file
    made: list[tuple[Recording, bytes]] = []
    written: set[str] = set()
    check = _Replay(recordings, (lambda recording, data: made.append((recording, data))) if frames else None)
    outcome = Outcome()
    most = max((recording.steps for found in recordings.values() for recording in found), default=0)
    again = list(environments.values())
    for number, report in _run(stored(store, again), contract, driver, check, most, 0, None, workers, tell):
        environment = again[number]
        while made:
            recording, data = made.pop()
            store.keep(keeping.cache_place(store, files[id(recording)]), data)
            written.add(files[id(recording)])
        missing = frames and any(files[id(recording)] not in written for recording in recordings[environment.name])
        if missing or report.verdict is not Verdict.PASS:
            outcome.bad.append(report)
        outcome.done += len(recordings[environment.name])
        outcome.steps += sum(recording.steps for recording in recordings[environment.name])
    return outcome


def episodes(
    targets: Sequence[Target],
    player: Player,
    contract: Contract,
    driver: Driver,
    count: int,
    seed: int = 0,
    workers: int | None = None,
    tell: Tell | None = None,
) -> Iterator[tuple[int, list[keeping.Outcome], SubjectReport]]:
    """Have `player` play `count` whole episodes in each of `targets`, which have different paths.

    As each is done, its place among the targets, what came out of its episodes (nothing where one went wrong), and the
    report that says so. Raises what the sandbox raises.
    """
    made: dict[str, list[keeping.Outcome]] = {}
    check = _Count(player, count, made.__setitem__)
    for number, report in _run(targets, contract, driver, check, count * _LONGEST, seed, player, workers, tell):
        yield number, made.pop(report.path, []), report


def _run(
    targets: Sequence[Target],
    contract: Contract,
    driver: Driver,
    check: Check,
    steps: int,
    seed: int,
    player: Player | None,
    workers: int | None,
    tell: Tell | None,
) -> Iterator[tuple[int, SubjectReport]]:
    """Judge environments by one check alone; as each ends, its place and its report."""
    if not targets:
        return
    limits = Limits(total=3600.0 * max(1.0, steps / _HOUR))
    policy = player.policy if player is not None else None
    plan = Plan(targets, contract, driver, [check], _BUDGET, seed, policy, limits)
    with (
        Pool(driver, limits, len(targets)) as pool,
        contextlib.closing(stream(plan, workers, pool)) as events,
    ):
        for number, event in events:
            if tell is not None:
                tell(event)
            if isinstance(event, SubjectFinished):
                yield number - 1, event.report
