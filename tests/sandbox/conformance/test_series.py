"""Jobs of a series: in one process as long as each leaves it as it was, and as if each had one of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import pytest

from envcraft.judging.driver import Driver, Worker
from envcraft.model.job import ExitReason

from .conftest import Environment

_TOLD = "import json, os, random, sys, threading\nimport numpy as np\n"
_PROCESS = _TOLD + "print(json.dumps(os.getpid()))"


@pytest.fixture
def follow(worker: Worker, environment: Environment, play: Any) -> Any:
    """Plays episodes of a new series, one after the other."""
    play(worker, environment())

    def ask(source: str) -> Any:
        return play(worker, source, series=True)

    return ask


def test_a_process_runs_one_after_the_other(follow: Any, worker: Worker, environment: Environment, play: Any) -> None:
    source = environment(top=_PROCESS)
    ran = [follow(source) for _ in range(4)]
    assert [one.end.before for one in ran] == [0, 1, 2, 3]
    assert len({one.facts for one in ran}) == 1
    alone = play(worker, source)
    assert alone.end.before == 0
    assert alone.facts != ran[0].facts
    assert {tuple(one.trace.observations) for one in ran} == {tuple(alone.trace.observations)}


def test_a_process_runs_only_so_many(follow: Any, environment: Environment) -> None:
    source = environment(top=_PROCESS)
    assert len({follow(source).facts for _ in range(100)}) > 1


def test_a_first_one_has_a_new_process_that_others_follow_in(
    follow: Any, worker: Worker, environment: Environment, play: Any
) -> None:
    source = environment(top=_PROCESS)
    before = follow(source)
    first, after = play(worker, source, series=True, new_process=True), follow(source)
    assert [one.end.before for one in (before, first, after)] == [0, 0, 1]
    assert before.facts != first.facts == after.facts


@pytest.mark.parametrize(
    "top",
    [
        "print(json.dumps(os.listdir('.')))\nopen('left', 'w').write('x')\nos.makedirs('deep/er', exist_ok=True)",
        "print(json.dumps('LEFT' in os.environ))\nos.environ['LEFT'] = 'x'",
        "print(json.dumps(sys.getrecursionlimit()))\nsys.setrecursionlimit(5000)",
        "print(json.dumps(np.geterr()))\nnp.seterr(all='raise')",
        "print(json.dumps([random.random(), np.random.random()]))",
        "print(json.dumps(os.getcwd()))\nos.makedirs('deep')\nos.chdir('deep')",
        "print(json.dumps(globals().get('seen')))\nseen = 1",
    ],
    ids=["files", "variables", "recursion", "floating", "random", "folder", "module"],
)
def test_the_next_one_does_not_see(follow: Any, environment: Environment, top: str) -> None:
    first, second = (follow(environment(top=_TOLD + top)) for _ in range(2))
    assert second.end.before
    assert second.facts == first.facts


@pytest.mark.parametrize(
    ("top", "step"),
    [
        ("threading.Thread(target=threading.Event().wait, daemon=True).start()", ""),
        ("", "raise ValueError"),
        ("", "if self.steps == 3: os._exit(0)"),
        ("import gymnasium\ngymnasium.seen = 1", ""),
        ("gym.Env.seen = 1", ""),
        ("", "self.metadata['seen'] = 1"),
        ("", "random.random = lambda: 0.5"),
        ("child = os.fork()\nif not child:\n    import time\n    time.sleep(60)", ""),
        ("", "while self.steps == 3: pass"),
    ],
    ids=["thread", "exception", "exit", "module", "class", "metadata", "function", "process", "hang"],
)
def test_leftovers_and_failures_end_the_process(follow: Any, environment: Environment, top: str, step: str) -> None:
    tidy = environment(top=_PROCESS)
    first = follow(tidy)
    untidy = follow(environment(top=_TOLD + top, step=step))
    assert untidy.end.before == first.end.before + 1
    after = follow(tidy)
    assert after.end.before == 0
    assert after.end.reason is ExitReason.DONE
    assert after.facts != first.facts


_WINDOW = """
import json
import pygame
print(json.dumps([pygame.get_init(), pygame.display.get_init(), pygame.mixer.get_init(), pygame.event.custom_type()]))
pygame.init()
print(json.dumps([pygame.display.get_surface() is None, len(pygame.event.get()), pygame.key.get_repeat()]))
pygame.display.set_mode((64, 48))
pygame.key.set_repeat(7, 9)
pygame.event.post(pygame.event.Event(pygame.USEREVENT))
"""


@pytest.fixture
def new_worker(driver: Driver, limits: Any) -> Iterator[Worker]:
    """A worker that no other test has."""
    pytest.importorskip("pygame")
    with contextlib.closing(driver.launch(hash_seed=0, limits=limits)) as launched:
        yield launched


def test_the_next_one_does_not_see_the_window(new_worker: Worker, environment: Environment, play: Any) -> None:
    assert new_worker.preload(["pygame"]) == ["pygame"]
    source = environment(top=_WINDOW)
    ran = [play(new_worker, source, series=True) for _ in range(3)]
    assert [one.end.before for one in ran] == [0, 1, 2]
    assert {one.end.output for one in ran} == {play(new_worker, source).end.output}


@pytest.mark.parametrize("changed", ["draw.circle = None", "quit = lambda: None"])
def test_a_changed_pygame_ends_the_process(
    new_worker: Worker, environment: Environment, play: Any, changed: str
) -> None:
    assert new_worker.preload(["pygame"]) == ["pygame"]
    tidy, untidy = environment(top="import pygame"), environment(top="import pygame", step=f"pygame.{changed}")
    ran = [play(new_worker, source, series=True) for source in (tidy, untidy, tidy)]
    assert [one.end.before for one in ran] == [0, 1, 0]


def test_an_import_of_pygame_ends_the_process(new_worker: Worker, environment: Environment, play: Any) -> None:
    source = environment(top="import pygame")
    assert [play(new_worker, source, series=True).end.before for _ in range(2)] == [0, 0]


def test_output_belongs_to_the_job_that_printed_it(follow: Any, environment: Environment) -> None:
    ran = [follow(environment(top=f"print({number})", step="print('.', end='')")) for number in range(5)]
    assert [one.end.output for one in ran] == [f"{number}\n{'.' * 8}" for number in range(5)]


def test_a_worker_that_ends_takes_it_along(driver: Driver, limits: Any, environment: Environment, play: Any) -> None:
    worker = driver.launch(hash_seed=0, limits=limits)
    assert play(worker, environment(), series=True).end.reason is ExitReason.DONE
    worker.close()
    worker.close()
