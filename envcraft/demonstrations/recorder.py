"""Records players in the environments of a corpus, in the sandbox and several at once, and replays the recordings."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

import msgspec

from envcraft.corpus.audit import stored_targets
from envcraft.corpus.store import Environment, Store, demonstrations
from envcraft.corpus.store.demonstrations import EpisodeOutcome, Key, Row
from envcraft.demonstrations import cache
from envcraft.demonstrations.format import Recording, RecordingBuilder, difference
from envcraft.demonstrations.player import Player
from envcraft.demonstrations.store import cache_path, load, save
from envcraft.errors import Skip
from envcraft.judging import policy as policy_rules
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check, Rule
from envcraft.judging.driver import Driver, Limits
from envcraft.judging.engine import Plan, stream
from envcraft.judging.settings import contract_digest
from envcraft.judging.shrink import repro
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.contract import Contract
from envcraft.model.events import Event, SubjectFinished
from envcraft.model.rollout import Action, Rollout
from envcraft.model.target import Target
from envcraft.model.trace import Trace, diverge
from envcraft.model.verdict import Finding, SubjectReport, Verdict

#: The time limit of an environment is one hour for each so many steps.
_STEPS_PER_HOUR = 50_000
#: The usual length of a long episode, for the time limit.
_EPISODE_STEPS = 1_000
_BUDGET = BUDGETS["standard"]
#: The seconds for an action: a player that plans takes longer on a busy machine than an environment may for a step.
_PLANNING = 60.0

EventHandler = Callable[[Event], None]
#: The seed and the actions of an episode.
Played = tuple[int, list[Action]]


class _PlayerCheck(Check):
    """Lets a player play; violations of the rules for policies are findings."""

    name = "demonstrations"
    rules = policy_rules.RULES

    def __init__(self, player: Player) -> None:
        self._player = player

    def _episode(self, subject: Subject, number: int) -> Trace | Finding:
        """The player's episode with this number, as a trace of a list of actions, or the policy's violation.

        Raises:
            Skip: The episode has no step or is cut short, or the environment is not deterministic.
        """
        trace = self._player.play(subject, number)
        finding = policy_rules.judge_play(self, subject, trace)
        if finding is None and trace.rollout.live:
            # Recorded is what the policy's actions give without the policy.
            plain = subject.rollout(Rollout(trace.rollout.seed, trace.actions, player="the player's actions"))
            finding = policy_rules.judge_effect(self, subject, trace, plain)
            if finding is None and diverge(trace, plain, info=False) is not None:
                raise Skip(
                    f"the environment is not deterministic on seed {trace.rollout.seed}, so no recording is exact"
                )
            trace = plain
        if finding is not None:
            return finding
        if not trace.usable or not trace.steps:
            raise Skip(f"the episode on seed {trace.rollout.seed} is cut short: {trace.fault or trace.ending}")
        return trace


class _Record(_PlayerCheck):
    """Lets a player play a number of steps, and passes the episodes to `take`."""

    def __init__(self, player: Player, steps: int, take: Callable[[str, RecordingBuilder], object]) -> None:
        super().__init__(player)
        self._steps, self._take = steps, take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        builder = RecordingBuilder(self._steps)
        number = 0
        while builder.left:
            trace = self._episode(subject, number)
            if isinstance(trace, Finding):
                yield trace
                return
            if trace.steps > builder.left:
                trace = subject.rollout(trace.rollout.cut(builder.left))
            builder.add(trace)
            number += 1
        self._take(subject.target.path, builder)


class _Evaluate(_PlayerCheck):
    """Lets a player play a number of episodes, and passes their outcomes to `take`."""

    def __init__(self, player: Player, episodes: int, take: Callable[[str, list[EpisodeOutcome]], object]) -> None:
        super().__init__(player)
        self._episodes, self._take = episodes, take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        outcomes = []
        for number in range(self._episodes):
            trace = self._episode(subject, number)
            if isinstance(trace, Finding):
                yield trace
                return
            outcomes.append(EpisodeOutcome(trace.steps, trace.total, trace.success))
            subject.cache.clear_traces()
        self._take(subject.target.path, outcomes)


class _Advise(_PlayerCheck):
    """Asks a player for advice on episodes that others played, and passes the actions to `take`."""

    def __init__(
        self, player: Player, episodes: dict[str, list[Played]], take: Callable[[str, list[list[Action]]], object]
    ) -> None:
        super().__init__(player)
        self._episodes, self._take = episodes, take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        advice = []
        for seed, actions in self._episodes[subject.target.path]:
            advice.append(self._player.advise(subject, seed, actions))
            subject.cache.clear_traces()
        self._take(subject.target.path, advice)
        yield from ()


class _Replay(Check):
    """Plays every episode of a recording again; a difference is a finding. With `take`, passes the cache to it."""

    name = "demonstrations"
    rules = (
        Rule(
            "EC201",
            "run-again",
            "The same seed gives another trace when it is run again.",
            "Draw from self.np_random only.",
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
                # Bypasses the rollout cache: with frames a trace is large, and it is needed once.
                trace = subject.rerun(rollout)
                if changed := difference(episode, trace):
                    words = (
                        f"episode {number} of the player {recording.player}, on seed {episode.seed}, differs: {changed}"
                    )
                    yield self.finding("EC201", words, repro=repro(rollout))
                    writer = None
                    break
                if writer is not None:
                    writer.add(episode, trace.frames)
            if writer is not None and self._take is not None:
                self._take(recording, writer.to_bytes())


class RunResult(msgspec.Struct):
    """The result of a run.

    Attributes:
        done: The number of environments or recordings that were played.
        steps: The number of steps in them.
        failed: The reports on environments that did not pass.
    """

    done: int = 0
    steps: int = 0
    failed: list[SubjectReport] = []


def record(
    store: Store,
    chosen: Sequence[Environment],
    player: Player,
    contract: Contract,
    driver: Driver,
    steps: int,
    seed: int = 0,
    workers: int | None = None,
    on_event: EventHandler | None = None,
) -> RunResult:
    """Let a player play each environment that has no such recording yet, and store the recordings.

    Each recording is stored as soon as it is complete.

    Args:
        store: The corpus, open for writing.
        chosen: The environments.
        player: The player.
        contract: The contract under which they are played.
        driver: The sandbox.
        steps: The number of steps in each environment.
        seed: The seed from which the episodes' seeds derive.
        workers: The number of environments that are played at once; by default one for each core.
        on_event: Receives the progress.

    Returns:
        The counts, and reports on the environments that failed.

    Raises:
        OSError: A file cannot be written.
        EnvCraftError: The sandbox fails.
    """
    digest = contract_digest(contract)
    pending = []
    for environment in chosen:
        row = demonstrations.get(
            store,
            Key(environment.source, environment.env_class, digest, player.name, player.digest, seed),
        )
        if row is None or row.steps < steps:
            pending.append(environment)
    built: dict[str, RecordingBuilder] = {}
    result = RunResult()
    check = _Record(player, steps, built.__setitem__)
    targets = stored_targets(store, pending)
    for number, report in _run(targets, contract, driver, check, steps, seed, player, workers, on_event):
        environment = pending[number]
        builder = built.pop(environment.name, None)
        if builder is None:
            result.failed.append(report)
            continue
        recording = builder.recording(
            source=environment.source,
            env_class=environment.env_class,
            contract=contract.name,
            contract_sha256=digest,
            player=player.name,
            player_digest=player.digest,
            seed=seed,
        )
        save(store, recording)
        result.done += 1
        result.steps += recording.steps
    return result


def replay(
    store: Store,
    named: Sequence[tuple[str, Row]],
    contract: Contract,
    driver: Driver,
    frames: bool,
    workers: int | None = None,
    on_event: EventHandler | None = None,
) -> RunResult:
    """Play recordings again, to compare them or to write their frame caches.

    Args:
        store: The corpus, open for writing.
        named: The recordings, each with the name of its environment.
        contract: The contract under which they were recorded.
        driver: The sandbox.
        frames: Write the caches that are missing, and play no other recordings.
        workers: The number of environments that are played at once; by default one for each core.
        on_event: Receives the progress.

    Returns:
        The counts, and reports on the environments with a difference or without a cache.

    Raises:
        OSError: A file cannot be written.
        CorpusDamaged: A recording cannot be read.
        EnvCraftError: The sandbox fails.
    """
    recordings: dict[str, list[Recording]] = {}
    environments: dict[str, Environment] = {}
    files: dict[int, str] = {}
    for name, row in named:
        if frames and cache_path(store, row.file).exists():
            continue
        recording = load(store, row)
        recordings.setdefault(name, []).append(recording)
        environments[name] = Environment(name, row.source, row.env_class)
        files[id(recording)] = row.file
    caches: list[tuple[Recording, bytes]] = []
    written: set[str] = set()
    check = _Replay(recordings, (lambda recording, data: caches.append((recording, data))) if frames else None)
    result = RunResult()
    steps = max((recording.steps for several in recordings.values() for recording in several), default=0)
    chosen = list(environments.values())
    for number, report in _run(
        stored_targets(store, chosen), contract, driver, check, steps, 0, None, workers, on_event
    ):
        environment = chosen[number]
        while caches:
            recording, data = caches.pop()
            store.keep(cache_path(store, files[id(recording)]), data)
            written.add(files[id(recording)])
        missing = frames and any(files[id(recording)] not in written for recording in recordings[environment.name])
        if missing or report.verdict is not Verdict.PASS:
            result.failed.append(report)
        result.done += len(recordings[environment.name])
        result.steps += sum(recording.steps for recording in recordings[environment.name])
    return result


def episodes(
    targets: Sequence[Target],
    player: Player,
    contract: Contract,
    driver: Driver,
    count: int,
    seed: int = 0,
    workers: int | None = None,
    on_event: EventHandler | None = None,
) -> Iterator[tuple[int, list[EpisodeOutcome], SubjectReport]]:
    """Let a player play whole episodes in each environment.

    Args:
        targets: The environments, with different paths.
        player: The player.
        contract: The contract under which they are played.
        driver: The sandbox.
        count: The number of episodes in each.
        seed: The seed from which the episodes' seeds derive.
        workers: The number of environments that are played at once; by default one for each core.
        on_event: Receives the progress.

    Returns:
        For each environment, when it is done: its index among the targets, the outcomes of its episodes (none if one
        failed), and its report.

    Raises:
        EnvCraftError: The sandbox fails.
    """
    outcomes: dict[str, list[EpisodeOutcome]] = {}
    check = _Evaluate(player, count, outcomes.__setitem__)
    for number, report in _run(
        targets, contract, driver, check, count * _EPISODE_STEPS, seed, player, workers, on_event
    ):
        yield number, outcomes.pop(report.path, []), report


def advise(
    targets: Sequence[Target],
    player: Player,
    contract: Contract,
    driver: Driver,
    played: Sequence[list[Played]],
    workers: int | None = None,
) -> Iterator[tuple[int, list[list[Action]], SubjectReport]]:
    """Ask a player what it would do in each state of episodes that another player played.

    Args:
        targets: The environments, with different paths.
        player: The player.
        contract: The contract under which the episodes were played.
        driver: The sandbox.
        played: The episodes in each environment.
        workers: The number of environments that are played at once; by default one for each core.

    Returns:
        For each environment, when it is done: its index among the targets, the player's actions in its episodes (none
        if one failed), and its report.

    Raises:
        EnvCraftError: The sandbox fails.
    """
    advice: dict[str, list[list[Action]]] = {}
    by_path = {target.path: episodes for target, episodes in zip(targets, played, strict=True)}
    check = _Advise(player, by_path, advice.__setitem__)
    steps = max((sum(len(actions) for _, actions in episodes) for episodes in played), default=0)
    for number, report in _run(targets, contract, driver, check, steps, 0, player, workers, None):
        yield number, advice.pop(report.path, []), report


def _run(
    targets: Sequence[Target],
    contract: Contract,
    driver: Driver,
    check: Check,
    steps: int,
    seed: int,
    player: Player | None,
    workers: int | None,
    on_event: EventHandler | None,
) -> Iterator[tuple[int, SubjectReport]]:
    """Judge environments by one check; yield the index and the report of each when it is done."""
    if not targets:
        return
    seconds = 3600.0 * max(1.0, steps / _STEPS_PER_HOUR)
    limits = Limits(call=_PLANNING, job=seconds)
    policy = player.policy if player is not None else None
    plan = Plan(targets, contract, driver, [check], _BUDGET, seed, policy, limits, time_limit=seconds)
    with (
        WorkerPool(driver, limits, len(targets)) as pool,
        contextlib.closing(stream(plan, workers, pool)) as events,
    ):
        for number, event in events:
            if on_event is not None:
                on_event(event)
            if isinstance(event, SubjectFinished):
                yield number - 1, event.report
