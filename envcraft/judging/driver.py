"""The interface of sandbox drivers. Drivers are plugins; :mod:`envcraft` itself runs no untrusted code.

A :class:`Driver` says whether it works on this machine and launches workers. A :class:`Worker` runs jobs. Each job
has a process that ends with it, except that the jobs of a series may share one. A job's messages are checked against
the protocol and go to a :class:`Recorder` as they arrive.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from envcraft.errors import SandboxUnavailable, UsageError
from envcraft.judging.installed import Installed, installed
from envcraft.model.job import JobResult

if TYPE_CHECKING:
    from envcraft_protocol.jobs import Job

    from envcraft.model.target import Target


class Isolation(StrEnum):
    """How a driver separates a worker from the machine, as reports state it. The strongest comes first."""

    CONTAINER = "container"
    NAMESPACE = "namespace"
    PROCESS = "process"


class Limits(msgspec.Struct, frozen=True):
    """What one job may use. Times are wall-clock seconds, sizes are bytes.

    Attributes:
        call: the longest time between two messages of a job, so the longest call of the environment.
        loading: the same while the file is imported.
        job: the longest time of one job, which is an episode or a search.
        total: the longest time of all jobs of one subject together.
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
    """Whether a driver works on this machine.

    Attributes:
        works: whether workers can be launched.
        reason: why they cannot.
        fix: what the user can do about it.
        layers: the protections in force.
        missing: the protections that this machine lacks.
    """

    works: bool
    reason: str = ""
    fix: str = ""
    layers: list[str] = []
    missing: list[str] = []


class Stop(Exception):
    """Raised by a recorder or a player to end its job."""


class Recorder(Protocol):
    """Receives a job's messages in order. :mod:`envcraft.spaces.codec` reads `layout` and `data`. A long value that
    repeats may arrive as the same object.
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
    """Chooses the actions of an interactive job, in a thread of its own. Its time does not count as the job's."""

    def action_requested(self) -> None:
        """The job waits for its next action."""

    def fileno(self) -> int:
        """A descriptor that becomes readable when :meth:`take` has an action."""

    def take(self) -> Any:
        """Return the next action, as JSON.

        Raises:
            Stop: the job ends here.
        """


class Step(msgspec.Struct, frozen=True):
    """What one call of reset or step returned.

    Attributes:
        terminated_type: the type's name as the worker gives it (``bool``, ``numpy bool``, …); so are the others.
        micros: how long the call took, in microseconds.
        layout: the number of the layout of `data`.
        data: the observation's bytes.
        info: JSON, empty for ``{}``.
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
    """Consecutive steps with the same observation and info. The fields are those of :class:`Step`; lists have one item
    for each step. An interactive job sends none.
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
    """A running worker, which runs one job at a time.

    Attributes:
        about: what the worker reports about itself: versions, and the protections of its jobs (``layers``,
            ``missing``).
    """

    about: dict[str, Any]

    @abstractmethod
    def preload(self, modules: list[str]) -> list[str]:
        """Import installed modules once, before jobs are forked.

        Returns:
            The modules that could be imported.

        Raises:
            WorkerLost: the worker is gone.
        """

    @abstractmethod
    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        """Look modules up without importing them.

        Returns:
            Those of `modules` that are not installed, and if there are any, the names of all installed ones.

        Raises:
            WorkerLost: the worker is gone.
        """

    @abstractmethod
    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        """Run a job until it ends, for whichever reason.

        Args:
            job: with ``series`` its process may be that of the job before, if that job was of a series and left nothing
                behind; with ``new_process`` it is a new one, in which others may follow.
            recorder: receives the job's messages, in the calling thread.
            limits: what the job may use.
            player: chooses the actions of an interactive job; the recorder receives them, too.

        Returns:
            Why the job ended, and what it used.

        Raises:
            WorkerLost: the worker itself is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """End the worker and everything in it. May be called twice."""


class Driver(ABC):
    """A way to isolate workers. A driver implements :meth:`probe` and :meth:`launch`; the other methods have defaults.

    Attributes:
        name: how ``--sandbox`` names it.
        isolation: what reports state.
        rank: ``auto`` takes the driver with the highest rank that works.
        packages: names of packages that the driver starts by name, such as its worker: a change in them makes verdicts
            stale.
    """

    name: str
    isolation: Isolation
    rank: int
    packages: tuple[str, ...] = ()

    @abstractmethod
    def probe(self) -> Availability:
        """Find out whether workers can be launched here. Nothing that it starts outlasts the call."""

    @cached_property
    def availability(self) -> Availability:
        """The result of the first :meth:`probe`. A driver whose probe raises does not work; others may."""
        try:
            return self.probe()
        except Exception as error:
            return Availability(False, f"it broke ({type(error).__name__}: {error})", "see `envcraft doctor`")

    @abstractmethod
    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        """Launch a worker, and wait until it is ready.

        Args:
            hash_seed: PYTHONHASHSEED of the worker.
            limits: what its jobs may use.

        Raises:
            SandboxUnavailable: the driver cannot launch it.
        """

    def start(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        """Launch a worker without waiting for it, where the driver can do that. The arguments are those of
        :meth:`launch`.

        Returns:
            A function that waits until the worker is ready and gives it. It may raise SandboxUnavailable, too.

        Raises:
            SandboxUnavailable: the driver cannot launch it.
        """
        return lambda: self.launch(hash_seed=hash_seed, limits=limits)

    def shared_layout(self) -> Driver:
        """A driver that launches many workers faster. Its workers with the same hash seed may share their memory
        layout, and nothing else. Close it after the last of them. By default this driver itself.
        """
        return self

    def with_runtime(self, runtime: str) -> Driver:
        """This driver with another container runtime.

        Raises:
            UsageError: the driver runs no containers.
        """
        raise UsageError(f"--runtime {runtime} goes with the docker sandbox, and this one is {self.name}")

    def with_installed(self, packages: Installed) -> Driver:
        """This driver with workers that can import what is installed on the host. By default this driver itself, for
        workers that have a file system of their own.
        """
        return self

    def image(self) -> str | None:
        """The digest of the image that workers run in, which the key of a verdict includes; None where they run on the
        host's interpreter.

        Raises:
            SandboxUnavailable: there is no image.
        """
        return None

    def sweep(self) -> None:  # noqa: B027 (most drivers leave nothing)
        """Remove what earlier processes left behind when they were killed. It is fast where there is nothing, and never
        fails.
        """

    def close(self) -> None:  # noqa: B027 (most drivers hold nothing)
        """End what the driver itself still holds."""


def choose(drivers: list[Driver], name: str) -> Driver:
    """Pick a driver by its name, or for ``auto`` the strongest that works here. A driver that is picked by its name may
    not work (:func:`ensure`).

    Raises:
        SandboxUnavailable: no driver has this name, or none works.
    """
    ranked = sorted(drivers, key=lambda driver: -driver.rank)
    if name == "auto":
        for driver in ranked:
            if driver.availability.works:
                return driver
        raise SandboxUnavailable("no sandbox works on this machine; `envcraft doctor` lists what each one needs")
    for driver in ranked:
        if driver.name == name:
            return driver
    raise SandboxUnavailable(f"no sandbox is called {name}; there are {', '.join(d.name for d in ranked)}")


def ensure(driver: Driver) -> None:
    """Check that a driver works here.

    Raises:
        SandboxUnavailable: it does not work; the message has the reason and the next step.
    """
    available = driver.availability
    if not available.works:
        raise SandboxUnavailable(f"the {driver.name} sandbox does not work here: {available.reason}; {available.fix}")


def driver_for(driver: Driver, targets: Iterable[Target]) -> Driver:
    """The driver whose workers can import what these targets need: what is installed on the host only where one of
    them is installed, too.
    """
    return driver.with_installed(installed()) if any(target.installed for target in targets) else driver
