"""Jobs that behave: what they give back, what they print, and the conditions they run under."""

from __future__ import annotations

import base64
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from envcraft_protocol.wire import HEADER, MAX_MESSAGE, Kind

from envcraft.errors import EnvCraftError
from envcraft.judging.driver import Driver, Limits, Worker
from envcraft.judging.installed import Installed
from envcraft.model.job import ExitReason
from envcraft.model.rollout import ClockShift, Conditions, Episode
from envcraft.model.trace import Ending

Environment = Callable[..., str]

_ACTIONS = [[number % 5, 0, 1] for number in range(9)]


class TestOrdinaryJobs:
    def test_a_rollout_gives_its_whole_trace(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment())
        assert ran.end.reason is ExitReason.DONE
        assert ran.trace.ending is Ending.TRUNCATED
        assert len(ran.trace.observations) == 9
        assert ran.trace.rewards == [0.0, 1.0, 2.0, 3.0, 4.0, 0.0, 1.0, 2.0]
        assert ran.trace.info() == {"steps": 8}
        assert ran.trace.problems == []

    def test_the_seed_alone_decides_the_trace(self, worker: Worker, environment: Environment, play: Any) -> None:
        first, again, other = (play(worker, environment(), seed=seed).trace for seed in (3, 3, 4))
        assert first.observations == again.observations
        assert first.observations != other.observations

    def test_a_project_is_a_copy_that_no_job_changes(self, worker: Worker, environment: Environment, play: Any) -> None:
        top = """
        from .helpers import SIZE, folder
        import errno, json, os
        def refusal():
            try:
                open(folder / "levels.txt", "w")
            except OSError as error:
                return errno.errorcode[error.errno]
        """
        reset = """
        seen = [SIZE, (folder / "levels.txt").read_text(), refusal(), __name__, sorted(os.listdir())]
        if seed == 1:
            os.unlink(folder / "levels.txt")
        print(json.dumps(seen))
        """
        texts = {
            "maze/__init__.py": "from .tiny import Tiny",
            "maze/helpers.py": "from pathlib import Path\nSIZE = 4\nfolder = Path(__file__).parent",
            "maze/levels.txt": "one",
        }
        files = {path: base64.b64encode(text.encode()).decode() for path, text in texts.items()}
        project = {"module": "maze.tiny", "path": "maze/tiny.py", "files": files}
        facts = [play(worker, environment(top=top, reset=reset), seed=seed, project=project).facts for seed in (1, 2)]
        assert facts == [[4, "one", "EACCES", "maze.tiny", ["maze"]]] * 2
        assert play(worker, environment(reset="import os; print(os.listdir())")).end.output == "[]\n"

    def test_a_description_names_the_class(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(), kind="describe")
        assert ran.description["class"] == "Tiny"
        assert ran.description["action_space"]["nvec"] == [5, 2, 2]

    def test_an_exception_is_a_fault(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(step="if self.steps == 3: raise SystemExit('enough')"))
        assert ran.end.reason is ExitReason.DONE
        assert ran.trace.steps == 2
        assert (ran.trace.fault.type, ran.trace.fault.step) == ("SystemExit", 3)

    def test_modules_are_found_and_preloaded(self, worker: Worker) -> None:
        missing, known = worker.find(["numpy", "math", "nunpy"])
        assert missing == ["nunpy"]
        assert "numpy" in known
        assert worker.preload(["gymnasium.spaces", "nunpy"]) == ["gymnasium.spaces"]

    def test_a_library_cannot_replace_a_standard_module(
        self, driver: Driver, limits: Limits, environment: Environment, play: Any, tmp_path: Path
    ) -> None:
        names = ["enum", "json", "pathlib", "socket", "typing"]
        for name in names:
            (tmp_path / f"{name}.py").write_text("raise ImportError('for Python 2')")
        (tmp_path / "lantern.py").write_text("lit = True")
        other = driver.with_installed(Installed(paths=(str(tmp_path),)))
        if other is not driver:
            names.append("lantern")
        worker = other.launch(hash_seed=0, limits=limits)
        try:
            ran = play(worker, environment(top=f"import {', '.join(names)}"))
        finally:
            worker.close()
        assert ran.trace.steps == 8

    def test_many_jobs_leave_no_descriptor_open(self, worker: Worker, environment: Environment, play: Any) -> None:
        before = len(os.listdir("/proc/self/fd"))
        for seed in range(20):
            assert play(worker, environment(), seed=seed).trace.steps == 8
        # Fewer where an idle connection to the container engine is closed meanwhile.
        assert len(os.listdir("/proc/self/fd")) <= before

    def test_one_that_is_too_long_is_not_the_fault_of_the_environment(
        self, worker: Worker, environment: Environment, play: Any
    ) -> None:
        with pytest.raises(EnvCraftError, match="too long"):
            play(worker, environment(top="#" * MAX_MESSAGE))


class TestOutput:
    def test_it_is_captured_up_to_the_limit(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits
    ) -> None:
        ran = play(worker, environment(step="print('x' * 999)"))
        assert ran.end.reason is ExitReason.DONE
        assert ran.end.output_bytes == 8000
        assert len(ran.end.output) == limits.output

    def test_it_is_never_parsed(self, worker: Worker, environment: Environment, play: Any) -> None:
        message = HEADER.pack(Kind.END, 2) + b"{}"
        ran = play(worker, environment(step=f"import os; os.write(1, {message!r}); os.write(2, {message!r})"))
        assert ran.trace.steps == 8
        assert ran.end.output.count("{}") == 16

    def test_what_was_not_flushed_is_not_lost(self, worker: Worker, environment: Environment, play: Any) -> None:
        assert play(worker, environment(step="print('.', end='')")).end.output == "." * 8

    @pytest.mark.parametrize(
        "lines", ["while True: print('x' * 100)", "import os\nwhile True: os.write(2, b'x' * 4096)"]
    )
    def test_a_flood_ends_the_job(self, worker: Worker, environment: Environment, play: Any, lines: str) -> None:
        ran = play(worker, environment(step=lines))
        assert ran.end.reason is ExitReason.FLOOD
        assert ran.end.phase == "step"


class TestConditions:
    def test_the_environment_variables_are_scrubbed(
        self, driver: Driver, limits: Limits, environment: Environment, play: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("ENVCRAFT_SECRET", "canary")
        source = environment(top="import json, os; print(json.dumps(dict(os.environ)))")
        worker = driver.launch(hash_seed=0, limits=limits)
        try:
            found = play(worker, source).facts
        finally:
            worker.close()
        assert "canary" not in found.values()
        assert os.environ["PATH"] not in found.values() or driver.name == "docker"
        proxies = {name for name in found if name.lower().endswith("_proxy")}
        assert {found[name] for name in proxies} <= {""}
        assert found.keys() - proxies <= {
            "PATH", "HOME", "TMPDIR", "LANG", "LC_CTYPE", "PWD", "HOSTNAME", "OPENBLAS_NUM_THREADS",
            "OMP_NUM_THREADS", "MKL_NUM_THREADS", "SDL_VIDEODRIVER", "SDL_AUDIODRIVER", "PYGAME_HIDE_SUPPORT_PROMPT",
            "PYTHONPATH", "PYTHONHASHSEED", "PYTHONDONTWRITEBYTECODE", "PYTHONNOUSERSITE",
            "PYTHONSAFEPATH", "PYTHONUNBUFFERED", "MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_",
        }  # fmt: skip

    def test_a_module_finds_no_command_line(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(top="import json, sys; print(json.dumps(sys.argv))")
        assert play(worker, source).facts == [""]

    def test_the_hash_seed_is_honoured(
        self, driver: Driver, limits: Limits, environment: Environment, play: Any
    ) -> None:
        hashes = []
        for seed in (5, 5, 6):
            worker = driver.launch(hash_seed=seed, limits=limits)
            try:
                assert worker.about["hash_seed"] == str(seed)
                hashes.append(play(worker, environment(top="print(hash('a'))")).facts)
            finally:
                worker.close()
        assert hashes[0] == hashes[1] != hashes[2]

    @pytest.mark.parametrize(
        "reading",
        [
            "time.time()", "time.monotonic_ns()", "time.localtime()", "time.gmtime(None)", "time.ctime()",
            "time.asctime()", "time.strftime('%c')", "time.clock_gettime(time.CLOCK_REALTIME)",
            "time.clock_gettime_ns(time.CLOCK_MONOTONIC)", "datetime.datetime.now().isoformat()",
            "datetime.date.today().isoformat()",
        ],
    )  # fmt: skip
    def test_clock_condition_replaces_readings(
        self, worker: Worker, environment: Environment, play: Any, reading: str
    ) -> None:
        source = environment(top=f"import datetime, json, time; print(json.dumps({reading}))")
        logical, again, real = (
            play(worker, source, conditions=Conditions(clock=clock)).facts
            for clock in (ClockShift(0.0, 0.0), ClockShift(0.0, 0.0), None)
        )
        assert logical == again != real

    @pytest.mark.parametrize("name", ["pygame.time.Clock", "pygame.Clock"])
    def test_clock_condition_replaces_the_readings_of_pygame(
        self, worker: Worker, environment: Environment, play: Any, name: str
    ) -> None:
        pytest.importorskip("pygame")
        top = "import json, pygame, time; pygame.init(); time.sleep(0.05)"
        top = f"{top}; clock = {name}()"
        ticks = "print(json.dumps([clock.tick(20), clock.tick(20), clock.get_time(), pygame.time.get_ticks() // 10]))"
        logical, again, real = (
            play(worker, environment(top=f"{top}; {ticks}"), conditions=Conditions(clock=clock)).facts
            for clock in (ClockShift(0.0, 0.0), ClockShift(0.0, 0.0), None)
        )
        assert logical == again == [50, 50, 50, 10]
        assert real != logical

    def test_another_moment_is_written_as_ever(self, worker: Worker, environment: Environment, play: Any) -> None:
        told = "[time.gmtime(0), time.ctime(7), time.strftime('%c', time.gmtime(3)), time.asctime(time.gmtime(5))]"
        source = environment(top=f"import json, time; print(json.dumps({told}))")
        logical = play(worker, source, conditions=Conditions(clock=ClockShift(0.0, 0.0)))
        assert logical.facts == play(worker, source).facts

    @pytest.mark.parametrize("module", ["random", "np.random"])
    def test_who_replaces_seeding_is_perturbed_all_the_same(
        self, worker: Worker, environment: Environment, play: Any, module: str
    ) -> None:
        top = f"import random\n{module}.seed = lambda *_: None"
        source = environment(top=top, step=f"print({module}.random())")
        plain, perturbed = (
            play(worker, source, conditions=Conditions(perturb=perturb)).end.output for perturb in (None, 5)
        )
        assert plain
        assert plain != perturbed

    @pytest.mark.parametrize(
        ("conditions", "steps"),
        [
            (Conditions(), 8),
            (Conditions(again=True), 16),
            (Conditions(before=[Episode(1, _ACTIONS[:3]), Episode(2, _ACTIONS)]), 3 + 8 + 8),
            (Conditions(companion=Episode(1, _ACTIONS)), 16),
            (Conditions(after_end=3), 11),
        ],
        ids=["plain", "again", "before", "companion", "after the end"],
    )
    def test_steps_of_every_kind_are_counted(
        self, worker: Worker, environment: Environment, play: Any, conditions: Conditions, steps: int
    ) -> None:
        ran = play(worker, environment(step="print('.', end='')"), conditions=conditions)
        assert ran.end.steps == steps == ran.end.output.count(".")

    def test_workers_are_independent(
        self, driver: Driver, limits: Limits, worker: Worker, environment: Environment, play: Any
    ) -> None:
        other = driver.launch(hash_seed=0, limits=limits)
        hung: list[Any] = []
        thread = threading.Thread(target=lambda: hung.append(play(other, environment(step="while True: pass"))))
        thread.start()
        assert play(worker, environment()).trace.steps == 8
        thread.join()
        assert hung[0].end.reason is ExitReason.TIMEOUT
        other.close()
        assert play(worker, environment()).trace.steps == 8


def test_the_fields_of_each_state(worker: Worker, play: Any, environment: Environment) -> None:
    source = environment(reset="self.seen = []", step="self.seen.append(int(action[0]))")
    ran = play(worker, source, fields=True)
    assert (ran.end.reason, len(ran.trace.states)) == ("done", 9)
    shown = [change.changed.get("self.seen", ("", ""))[1] for change in ran.trace.states]
    assert shown[:4] == ["[]", "[0]", "[0, 1]", "[0, 1, 2]"]
    assert {"random", "self.np_random", "self.steps"} <= ran.trace.states[0].changed.keys()
    line = 1 + source.splitlines().index("        self.seen.append(int(action[0]))")
    assert [line in change.lines for change in ran.trace.states] == [False, *[True] * 8]
    assert not play(worker, source).trace.states
