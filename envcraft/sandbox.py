"""What a sandbox driver promises. Drivers are plugins; :mod:`envcraft` itself runs no untrusted code.

A :class:`Driver` says whether it works on this machine and launches workers. A :class:`Worker` runs jobs: one job, one
process that dies with it, but for the jobs of a series. A job's messages go to a :class:`Recorder` as they arrive,
checked against the protocol.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from envcraft.errors import SandboxUnavailable, UsageError
from envcraft.installed import Installed, installed

if TYPE_CHECKING:
    from envcraft.target import Target


class Isolation(StrEnum):
    """How far a driver separates a worker from the machine, as reports state it; strongest first."""

    CONTAINER = "container"
    NAMESPACE = "namespace"
    PROCESS = "process"


class Limits(msgspec.Struct, frozen=True):
    """What one job may use. Times are wall-clock seconds, sizes bytes.

    `call` bounds the time between two signs of life, so any one call; `loading` does so while the file is imported;
    `job` bounds one job, which is an episode or a search; `total` all jobs of one subject together.
    """

    call: float = 5.0
    loading: float = 10.0
    job: float = 300.0
    total: float = 3600.0
    memory: int = 2 * 1024**3
    cpu: int = 600
    file: int = 16 * 1024**2
    disk: int = 96 * 1024**2
    descriptors: int = 256
    processes: int = 64
    output: int = 64 * 1024
    output_total: int = 16 * 1024**2


class Availability(msgspec.Struct, frozen=True):
    """Whether a driver works here; when not, why, and what to do.

    `layers` are the protections in force, `missing` those that this machine lacks.
    """

    works: bool
    reason: str = ""
    fix: str = ""
    layers: list[str] = []
    missing: list[str] = []


class How(StrEnum):
    """How a job ended."""

    DONE = "done"  #: it said so itself
    TIMEOUT = "timeout"  #: no sign of life within the deadline
    DIED = "died"  #: the process ended without saying so
    FORGED = "forged"  #: its messages break the protocol
    FLOOD = "flood"  #: it printed more than the limit
    MEMORY = "memory"  #: it held more memory than the limit
    PROCESSES = "processes"  #: it ran more threads than the limit
    DISK = "disk"  #: it wrote more to files than the limit
    STOPPED = "stopped"  #: the recorder wanted no more


class JobEnd(msgspec.Struct, frozen=True):
    """The end of a job. `signal` or `exit_code` is set when it died; `output` is the head of what it printed.

    `cpu` is the processor time of its processes, in seconds; `before` counts the jobs of a series that its process had
    done before, whose processor time is only known at the end of the last. `waits` counts the steps that gave up the
    processor to wait for something, where the job was to measure that.
    """

    how: How
    phase: str
    seconds: float
    signal: int | None = None
    exit_code: int | None = None
    detail: str = ""
    output: str = ""
    output_bytes: int = 0
    cpu: float = 0.0
    before: int = 0
    waits: int = 0


class Stop(Exception):
    """Raised by a recorder or a player to end its job."""


class Recorder(Protocol):
    """Receives a job's messages in order. `layout` and `data` are as :mod:`envcraft.values` reads them; a long value
    that comes again may come as the very object that it came as before.
    """

    def phase(self, name: str) -> None: ...
    def loaded(self, description: dict[str, Any]) -> None: ...
    def layout(self, description: dict[str, Any]) -> None: ...
    def reset(self, step: Step) -> None: ...
    def action(self, action: Any) -> None: ...
    def step(self, step: Step) -> None: ...
    def steps(self, steps: Steps) -> None: ...
    def after(self, step: Step) -> None: ...
    def render(self, layout: int, data: memoryview) -> None: ...
    def reread(self, layout: int, data: memoryview) -> None: ...
    def acted(self, action: Any) -> None: ...
    def fault(self, report: dict[str, Any]) -> None: ...
    def result(self, outcome: dict[str, Any]) -> None: ...
    def end(self) -> None: ...


class Player(Protocol):
    """Chooses the actions of a job that asks for them, in a thread of its own; the time that it takes is its own."""

    def asked(self) -> None:
        """The job waits for its next action."""

    def fileno(self) -> int:
        """A descriptor that can be read once :meth:`take` has something to give."""

    def take(self) -> Any:
        """The next action, as JSON. Raises Stop to end the job."""


class Step(msgspec.Struct, frozen=True):
    """What one call of reset or step returned. Types are the worker's words (``float``, ``numpy floating``, …).

    `data` is the observation's bytes under `layout`; `info` is JSON, empty for ``{}``.
    """

    terminated: bool
    truncated: bool
    terminated_type: str
    truncated_type: str
    reward_type: str
    reward: float
    micros: int
    layout: int
    data: memoryview
    info: bytes


class Steps(msgspec.Struct, frozen=True):
    """Steps, one after the other, with one observation and one info: fields as in :class:`Step`, lists with an item for
    each. Not of a job whose actions a player chooses.
    """

    terminated: list[bool]
    truncated: list[bool]
    terminated_types: list[str]
    truncated_types: list[str]
    reward_types: list[str]
    rewards: list[float]
    micros: list[int]
    layout: int
    data: memoryview
    info: bytes


class Worker(ABC):
    """A running worker."""

    #: What the worker says of itself: versions, and the layers that its jobs run under (``layers``, ``missing``).
    about: dict[str, Any]

    @abstractmethod
    def preload(self, modules: list[str]) -> list[str]:
        """Import installed modules before any job is forked; give those that could be. Raises WorkerLost."""

    @abstractmethod
    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        """Give the modules that are not installed, and if there are any, all that are. Raises WorkerLost."""

    @abstractmethod
    def run(self, job: dict[str, Any], recorder: Recorder, limits: Limits, player: Player | None = None) -> JobEnd:
        """Run a job to its end, whatever that is; `player` chooses the actions of one that asks for them, which the
        recorder is told. Where ``job["series"]`` is true, its process may be that of the one before, if that was of a
        series and left nothing behind; with ``job["first"]`` it is a new one, in which others may follow. Raises
        WorkerLost when the worker itself is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """End the worker and everything in it. May be called twice."""


class Driver(ABC):
    """A way to isolate workers."""

    name: str
    isolation: Isolation
    #: ``auto`` takes the available driver with the highest rank.
    rank: int

    @abstractmethod
    def probe(self) -> Availability:
        """Say whether workers can be launched here, by launching nothing that lasts."""

    @abstractmethod
    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        """Start a worker whose PYTHONHASHSEED is `hash_seed`. Raises SandboxUnavailable."""

    def begin(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        """Start a worker without waiting for it, where that is possible; what is returned waits, and gives it.

        Raises SandboxUnavailable, now or then.
        """
        return lambda: self.launch(hash_seed=hash_seed, limits=limits)

    def nursery(self) -> Driver:
        """This driver for many workers, which cost less each. Those with one hash seed may share their memory layout,
        and nothing else. Close it after the last of them; a driver that knows no such way gives itself.
        """
        return self

    def sibling(self, *, hash_seed: int, limits: Limits) -> Worker:
        """A worker that may share its memory layout with another one of this driver and hash seed. Raises
        SandboxUnavailable.
        """
        return self.launch(hash_seed=hash_seed, limits=limits)

    def under(self, runtime: str) -> Driver:
        """This driver with another container runtime. Raises UsageError where there are no containers."""
        raise UsageError(f"--runtime {runtime} goes with the docker sandbox, and this one is {self.name}")

    def seeing(self, found: Installed) -> Driver:
        """This driver, its workers able to import what is installed on the host. Drivers whose workers have a file
        system of their own give themselves: what they hold is all that there is.
        """
        return self

    def image(self) -> str | None:
        """The digest of the image that workers run in, so that verdicts of another are not taken for its own; None
        where they run on the host's interpreter. Raises SandboxUnavailable where there is none.
        """
        return None

    def sweep(self) -> None:  # noqa: B027 (most drivers leave nothing)
        """Remove what processes that were killed have left behind; cheap where there is nothing, and never fails."""

    def close(self) -> None:  # noqa: B027 (most drivers hold nothing)
        """End whatever the driver itself still holds."""


def choose(drivers: list[Driver], name: str) -> Driver:
    """Pick the driver called `name`, whether it works here or not (:func:`ensure`), or for ``auto`` the strongest that
    does. Raises SandboxUnavailable with the next step.
    """
    ranked = sorted(drivers, key=lambda driver: -driver.rank)
    if name == "auto":
        for driver in ranked:
            if _look(driver).works:
                return driver
        raise SandboxUnavailable("no sandbox works on this machine; `envcraft doctor` tells what each one needs")
    for driver in ranked:
        if driver.name == name:
            return driver
    raise SandboxUnavailable(f"no sandbox is called {name}; there are {', '.join(d.name for d in ranked)}")


def ensure(driver: Driver) -> None:
    """Raises SandboxUnavailable, with the reason and the next step, where a driver does not work here."""
    told = _look(driver)
    if not told.works:
        raise SandboxUnavailable(f"the {driver.name} sandbox does not work here: {told.reason}; {told.fix}")


def _look(driver: Driver) -> Availability:
    """What a driver says of itself. One that raises does not work, and the others may."""
    try:
        return driver.probe()
    except Exception as error:
        return Availability(False, f"it broke ({type(error).__name__}: {error})", "`envcraft doctor` tells more")


def driver_for(driver: Driver, targets: Iterable[Target]) -> Driver:
    """The driver whose workers see what these targets need: untrusted files alone see no more than the libraries."""
    return driver.seeing(installed()) if any(target.installed for target in targets) else driver
