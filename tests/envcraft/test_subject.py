"""Only requested rollouts count, in the order of the requests, however many jobs run at a time."""

from __future__ import annotations

import random
import threading
import time

import pytest
from envcraft_protocol.jobs import Job

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import Skip, WorkerLost
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Player, Recorder, Step, Worker
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.job import ExitReason, JobResult
from envcraft.model.rollout import ClockShift, Conditions, Episode, Rollout, Search
from envcraft.model.target import Target

ACTION = [0, 0, 0]


class Game(Worker):
    """An environment that never ends, on a machine of no constant speed.

    Seeds from 100 on hang, from 200 on die, from 300 on lose the worker, from 400 on die after another job,
    and from 500 on hang when they are first played.
    """

    def __init__(self, driver: Arcade, hash_seed: int) -> None:
        self.about = {"number": len(driver.games)}
        self.driver = driver
        self.hash_seed = hash_seed
        self.served: list[Job] = []
        self.preloaded: list[list[str]] = []
        self.series = 0
        self.ended = threading.Event()

    def preload(self, modules: list[str]) -> list[str]:
        self.preloaded.append(modules)
        return [] if self.driver.threads else modules

    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        return [], []

    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        self.served.append(job)
        time.sleep(random.random() * 0.002)
        before = self.series if job.get("series") and not job.get("new_process") else 0
        self.series = before + 1 if job.get("series") else 0
        if self.ended.is_set() or 300 <= job.get("seed", 0) < 400:
            raise WorkerLost("the worker is gone")
        late = job.get("seed", 0) >= 500 and sum(other.get("seed") == job["seed"] for other in self.served) == 1
        hangs = 100 <= job.get("seed", 0) < 200 or late
        if job["kind"] == "search":
            recorder.result({"steps": 5, "seed": job["seed"]})
        elif job["kind"] == "describe":
            effects = {"threads": self.driver.effect}
            recorder.loaded({"class": "Game", "effects": effects, "modules": ["torch", "torch.nn", "evil", "numba"]})
        else:
            recorder.layout({"k": "array", "dtype": "|u1", "shape": [2]})
            for number in range(len(job["actions"]) + 1):
                data = memoryview(bytes([job["seed"] % 256, number % 256]))
                step = Step(False, False, "bool", "bool", "float", 1.0, 1, 0, data, b"")
                (recorder.step if number else recorder.reset)(step)
        died = 200 <= job.get("seed", 0) < 300 or (400 <= job.get("seed", 0) < 500 and before > 0)
        if limits.job < 1.0:
            time.sleep(max(limits.job, 0.0))
            return JobResult(ExitReason.TIMEOUT, "step", limits.job)
        reason = ExitReason.TIMEOUT if hangs else ExitReason.DIED if died else ExitReason.DONE
        steps = (
            0 if reason is not ExitReason.DONE else 5 if job["kind"] == "search" else len(job.get("actions", ())) + 2
        )
        return JobResult(reason, "step", 1.0, before=before, steps=steps)

    def close(self) -> None:
        self.ended.set()


class Arcade(Driver):
    name = "arcade"
    rank = 1

    def __init__(self, isolation: Isolation = Isolation.CONTAINER, effect: int = 0, threads: bool = False) -> None:
        self.games: list[Game] = []
        self.isolation = isolation
        #: Threads that a job leaves after the import, and whether the fork server has some.
        self.effect, self.threads = effect, threads

    def probe(self) -> Availability:
        return Availability(True)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        self.games.append(Game(self, hash_seed))
        return self.games[-1]

    def shared_layout(self) -> Driver:
        return Arcade()

    @property
    def served(self) -> list[Job]:
        return [job for game in self.games for job in game.served]


def subject_of(driver: Driver, parallel_jobs: int, seconds: float | None = None) -> Subject:
    lease = WorkerPool(driver).lease()
    budget = BUDGETS["quick"]
    return Subject(Target("game.py", b""), ARCADE, lease, budget, parallel_jobs=parallel_jobs, seconds=seconds)


@pytest.mark.parametrize(
    ("isolation", "effect", "expected"),
    [
        (Isolation.CONTAINER, 0, ["torch", "torch.nn", "evil"]),
        (Isolation.CONTAINER, 1, []),
        (Isolation.PROCESS, 0, ["torch"]),
    ],
)
def test_fork_servers_import_once_what_the_file_imports(isolation: Isolation, effect: int, expected: list[str]) -> None:
    driver = Arcade(isolation, effect)
    source = b"import torch.nn\nimport evil\nimport json"
    with Subject(Target("game.py", source), ARCADE, WorkerPool(driver).lease(), BUDGETS["quick"]) as subject:
        subject.load()
        subject.rollout(play(0))
        subject.rollout(play(1, conditions=Conditions(fresh=True)))
    assert len(driver.games) == 2
    # A new worker starts without them, and imports them again.
    assert [game.preloaded for game in driver.games] == ([[expected]] * 2 if expected else [[], []])


def test_a_fork_server_in_which_a_library_starts_threads_forks_no_job() -> None:
    driver = Arcade(threads=True)
    with Subject(Target("game.py", b"import torch"), ARCADE, WorkerPool(driver).lease(), BUDGETS["quick"]) as subject:
        subject.load()
        subject.rollout(play(0))
    first, second = driver.games
    assert first.preloaded == [["torch", "torch.nn"]]
    assert [job["kind"] for job in first.served] == ["describe"]
    assert first.ended.is_set()
    assert second.preloaded == []


def play(seed: int, steps: int = 3, conditions: Conditions | None = None) -> Rollout:
    return Rollout(seed, [ACTION] * steps, conditions or Conditions())


@pytest.mark.parametrize("parallel_jobs", [1, 3])
def test_requested_rollouts_count_in_the_order_of_the_requests(parallel_jobs: int) -> None:
    with subject_of(Arcade(), parallel_jobs) as subject:
        subject.prefetch([play(seed, steps=seed) for seed in range(30)])
        asked = [7, 3, 3, 29, 0, 11]
        traces = [subject.rollout(play(seed, steps=seed)) for seed in asked]
        assert [trace.rollout.seed for trace in subject.traces] == [7, 3, 29, 0, 11]
        assert traces[1] is traces[2]
        # The worker counts two steps more than each trace shows.
        assert subject.steps == 9 + 5 + 31 + 2 + 13
        assert subject.seconds == 5


def test_parallel_jobs_share_the_work() -> None:
    driver = Arcade()
    with subject_of(driver, 3) as subject:
        subject.rollouts([play(seed) for seed in range(60)])
    assert len(driver.games) == 3
    assert len(driver.served) == 60
    assert all(len(game.served) > 5 for game in driver.games)
    assert all(game.ended.is_set() for game in driver.games)


def test_failure_after_other_jobs_reruns_alone() -> None:
    driver = Arcade()
    with subject_of(driver, 1) as subject:
        traces = subject.rollouts([play(0), play(401), play(1), play(250)])
        ends = [trace.end for trace in traces if trace.end is not None]
    assert [(end.reason, end.before) for end in ends] == [
        (ExitReason.DONE, 0),
        (ExitReason.DONE, 0),
        (ExitReason.DONE, 0),
        (ExitReason.DIED, 0),
    ]
    assert [trace.steps for trace in traces] == [3, 3, 3, 3]
    assert [job["seed"] for job in driver.served] == [0, 401, 401, 1, 250, 250, 250]


def test_a_deadline_that_is_kept_the_second_time_counts_as_kept() -> None:
    driver = Arcade()
    with subject_of(driver, 1) as subject:
        traces = [subject.rerun(play(seed)) for seed in range(500, 510)]
        assert [trace.end.reason for trace in traces if trace.end is not None] == [ExitReason.DONE] * 10
        hung = [subject.rerun(play(seed)) for seed in range(100, 103)]
        assert [trace.end.reason for trace in hung if trace.end is not None] == [ExitReason.TIMEOUT] * 3
        with pytest.raises(Skip, match="3 episodes or searches hung"):
            subject.rerun(play(103))


def test_compared_or_lasting_rollouts_run_in_a_new_process() -> None:
    driver = Arcade()
    passing = [Conditions(render=True), Conditions(before=[Episode(1, [ACTION])]), Conditions(after_end=2)]
    lasting = [
        Conditions(heap=1),
        Conditions(perturb=1),
        Conditions(clock=ClockShift(1.0, 2.0)),
        Conditions(again=True),
    ]
    with subject_of(driver, 1) as subject:
        subject.rollout(play(1))
        subject.rerun(play(2))
        subject.rerun(play(3), alone=False)
        subject.prefetch([play(4)], alone=True)
        subject.rollouts([play(4), *(play(5, conditions=conditions) for conditions in passing), play(6)])
        subject.rollout(play(7), alone=True)
        subject.cache.search(Search("explore", 9, 100))
        for conditions in lasting:
            subject.rollout(play(8, conditions=conditions))
        _ = subject.episodes.whole
        seed = subject.episode_seed(0)
    shared = [job for job in driver.served if job.get("series")]
    assert [job["seed"] for job in shared if not job.get("new_process")] == [1, 3, 5, 5, 5, 6, 9, seed]
    assert [job["seed"] for job in shared if job.get("new_process")] == [2, 4, 7, seed]


def test_prefetched_trace_has_the_requested_player() -> None:
    with subject_of(Arcade(), 2) as subject:
        subject.prefetch([Rollout(1, [ACTION], player="somebody")])
        assert subject.rollout(Rollout(1, [ACTION], player="me")).rollout.player == "me"


def test_cancelled_rollouts_do_not_run_until_requested() -> None:
    driver = Arcade()
    with subject_of(driver, 1) as subject:
        subject.prefetch([play(seed) for seed in range(100)])
        subject.cache.cancel_pending()
        assert subject.rollout(play(99)).steps == 3
    assert len(driver.served) < 100
    assert len(subject.traces) == 1


@pytest.mark.parametrize("parallel_jobs", [1, 3])
def test_timeouts_are_counted_in_the_order_of_the_requests(parallel_jobs: int) -> None:
    asked = [play(seed) for seed in (1, 101, 2, 102, 3, 103, 4, 5)]
    with subject_of(Arcade(), parallel_jobs) as subject:
        subject.prefetch(asked)
        time.sleep(0.02)
        for rollout in asked[:6]:
            subject.rollout(rollout)
        with pytest.raises(Skip, match="3 episodes or searches hung"):
            subject.rollout(asked[6])
        # What is known stays known.
        assert subject.rollout(asked[0]).rollout.seed == 1
        assert [trace.rollout.seed for trace in subject.traces] == [1, 101, 2, 102, 3, 103]


def test_hung_searches_use_up_patience_too() -> None:
    with subject_of(Arcade(), 2) as subject:
        for seed in (100, 101, 102):
            subject.searches.sweep([ACTION], seed, 100)
        with pytest.raises(Skip, match="hung"):
            subject.rollout(play(0))


@pytest.mark.parametrize(("seed", "times"), [(0, 1), (100, 2), (200, 2)])
def test_hang_or_death_reruns_with_every_step(seed: int, times: int) -> None:
    driver = Arcade()
    with subject_of(driver, 2) as subject:
        subject.prefetch([play(seed)])
        subject.rollout(play(seed))
    assert [bool(job.get("every_step")) for job in driver.served] == [False, True][:times]


@pytest.mark.parametrize("parallel_jobs", [1, 3])
def test_no_job_starts_or_runs_after_the_time_limit(parallel_jobs: int) -> None:
    driver = Arcade()
    with subject_of(driver, parallel_jobs, 60) as subject:
        subject.rollout(play(0))
        assert not subject.out_of_time
        # Less is left than a job takes.
        subject.time_limit.seconds -= subject.time_limit.left - 0.2
        with pytest.raises(Skip, match=r"out of time: the limit of [0-9.]+ s is reached"):
            subject.rollout(play(1))
        served = len(driver.served)
        subject.prefetch([play(seed) for seed in range(50)])
        with pytest.raises(Skip, match="out of time"):
            subject.rollout(play(2))
        assert subject.time_limit.decided
        assert len(driver.served) == served
        # What is known stays known, and a hang that the clock ended is no finding.
        assert subject.rollout(play(0)).steps == 3
        assert [trace.rollout.seed for trace in subject.traces] == [0]


def test_only_a_limit_that_nobody_named_can_be_shortened() -> None:
    for seconds, wanted in ((None, 50), (90, 90)):
        with subject_of(Arcade(), 1, seconds) as subject:
            subject.time_limit.shorten(50)
            subject.time_limit.shorten(70)
            assert subject.time_limit.seconds == wanted


@pytest.mark.parametrize("seeds", [(200, 201, 202), (100, 101, 102)])
def test_the_third_job_that_goes_wrong_in_the_same_way_is_the_last(seeds: tuple[int, ...]) -> None:
    driver = Arcade()
    with subject_of(driver, 1) as subject:
        for seed in seeds:
            subject.rollout(play(seed))
        served = len(driver.served)
        with pytest.raises(Skip, match=r"3 episodes or searches (died|hung): see sandbox$"):
            subject.rollout(play(1))
        with pytest.raises(Skip):
            subject.measured(play(2), 1.0)
        assert len(driver.served) == served
        assert not subject.time_limit.decided


def test_troubles_of_a_policy_are_told_from_others() -> None:
    with subject_of(Arcade(), 1) as subject:
        for seed in (200, 201, 202):
            subject.rollout(Rollout(seed, [], policy=True, max_steps=3))
        with pytest.raises(Skip, match=r"see sandbox, or difficulty for the policy$"):
            subject.rollout(play(1))


def test_different_troubles_are_counted_apart() -> None:
    with subject_of(Arcade(), 1) as subject:
        for seed in (100, 200, 101, 201):
            subject.rollout(play(seed))
        assert subject.rollout(play(0)).steps == 3


def test_deadlines_are_short_after_a_hang() -> None:
    driver = Arcade()
    given: list[Limits] = []
    with subject_of(driver, 1) as subject:
        subject.rollout(play(0))
        serve = Game.run

        def run(self: Game, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
            given.append(limits)
            return serve(self, job, recorder, limits, player)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Game, "run", run)
            for seed in (1, 100, 2):
                subject.rollout(play(seed))
    # The hang is confirmed under the full deadline.
    assert [limits.call for limits in given] == [5.0] * (len(given) - 1) + [2.0]
    assert given[0].job > 60
    assert given[-1].job == pytest.approx(20.0)


def test_lost_worker_fails_only_its_rollout() -> None:
    driver = Arcade()
    with subject_of(driver, 2) as subject:
        subject.prefetch([play(seed) for seed in (1, 300, 2)])
        assert subject.rollout(play(1)).steps == 3
        assert subject.rollout(play(2)).steps == 3
        for _ in range(2):
            with pytest.raises(WorkerLost):
                subject.rollout(play(300))
        assert subject.rollout(play(3)).steps == 3
        assert [trace.rollout.seed for trace in subject.traces] == [1, 2, 3]
    assert all(game.ended.is_set() for game in driver.games)


def test_conditions_run_beside_the_plain_rollout_and_fresh_ones_apart() -> None:
    driver = Arcade()
    with subject_of(driver, 3) as subject:
        for seed in range(9):
            subject.prefetch([play(seed), play(seed, conditions=Conditions(render=True))])
            subject.prefetch([play(seed)], again=True)
            subject.prefetch([play(seed, conditions=Conditions(fresh=True, hash_seed=5))])
        for seed in range(9):
            subject.rollout(play(seed))
            subject.rerun(play(seed))
            subject.rollout(play(seed, conditions=Conditions(render=True)))
            subject.rollout(play(seed, conditions=Conditions(fresh=True, hash_seed=5)))
            subject.rollout(play(seed, conditions=Conditions(hash_seed=5)))
    (apart,) = (game for game in driver.games if game.hash_seed == 5)
    assert len(apart.served) == 18
    for seed in range(9):
        homes = [game for game in driver.games for job in game.served if job["seed"] == seed and game is not apart]
        assert len(homes) == 3
        assert len(set(homes)) == 1


def test_a_fresh_rerun_has_a_worker_of_its_own_each_time() -> None:
    driver = Arcade()
    fresh = play(0, conditions=Conditions(fresh=True, heap=1))
    with subject_of(driver, 1) as subject:
        subject.rollout(play(0))
        for _ in range(3):
            subject.rerun(fresh)
    assert [len(game.served) for game in driver.games] == [1, 1, 1, 1]


@pytest.mark.parametrize(
    ("conditions", "again", "alike"),
    [
        (Conditions(), False, True),
        (Conditions(), True, True),
        (Conditions(hash_seed=5), False, True),
        (Conditions(fresh=True, hash_seed=5), False, True),
        (Conditions(fresh=True), False, False),
        (Conditions(fresh=True), True, False),
        (Conditions(fresh=True, hash_seed=5), True, False),
    ],
)
def test_only_what_is_fresh_and_no_other_hash_seed_needs_a_memory_layout_of_its_own(
    conditions: Conditions, again: bool, alike: bool
) -> None:
    driver = Arcade()
    with (
        WorkerPool(driver, subjects=2) as pool,
        Subject(Target("game.py", b""), ARCADE, pool.lease(), BUDGETS["quick"]) as subject,
    ):
        (subject.rerun if again else subject.rollout)(play(0, conditions=conditions))
    assert (not driver.games) is alike


def test_a_worker_that_is_lost_once_costs_no_verdict() -> None:
    driver = Arcade()
    with subject_of(driver, 1) as subject:
        subject.load()
        driver.games[0].ended.set()
        subject.prefetch([play(seed) for seed in range(3)])
        assert [subject.rollout(play(seed)).steps for seed in range(3)] == [3, 3, 3]
        assert subject.steps == 15
    assert len(driver.games) == 2


def test_about_comes_from_the_first_worker() -> None:
    with subject_of(Arcade(), 3) as subject:
        assert subject.about == {}
        subject.find_modules([])
        subject.rollouts([play(seed) for seed in range(30)])
        assert subject.about == {"number": 0}
