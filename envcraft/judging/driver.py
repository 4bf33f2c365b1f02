"""The interface of sandbox drivers. Drivers are plugins; :mod:`envcraft` itself runs no untrusted code.

A :class:`Driver` says whether it works on this machine and launches workers. A :class:`Worker` runs jobs. Each job
has a process that ends with it, except that the jobs of a series may share one. A job's messages are checked against
the protocol and go to a :class:`Recorder` as they arrive.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
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
    """

    call: float = 5.0
    loading: float = 30.0
    job: float = 300.0
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
    """Receives a job's messages in order.

    :mod:`envcraft.spaces.codec` decodes `layout` and `data`. A long value that repeats may arrive as the same object. A
    frame has a `digest` that identifies it, and its `data` is its picture or empty. Any other value has no digest.
    """

    def phase(self, name: str) -> None: ...
    def loaded(self, description: dict[str, Any]) -> None: ...
    def layout(self, description: dict[str, Any]) -> None: ...
    def reset(self, step: Step) -> None: ...
    def action(self, action: Any) -> None: ...
    def step(self, step: Step) -> None: ...
    def steps(self, steps: Steps) -> None: ...
    def after(self, step: Step) -> None: ...
    def render(self, layout: int, data: memoryview, digest: bytes = b"") -> None: ...
    def changed(self, report: dict[str, Any]) -> None: ...
    def space(self, report: dict[str, Any]) -> None: ...
    def acted(self, action: Any) -> None: ...
    def fault(self, report: dict[str, Any]) -> None: ...
    def result(self, outcome: dict[str, Any]) -> None: ...
    def fields(self, state: dict[str, Any]) -> None: ...
    def resources(self, measured: tuple[int, ...]) -> None: ...
    def end(self) -> None: ...


class Player(Protocol):
    """Chooses the actions of an interactive job in a separate thread. Its time does not count as the job's."""

    def action_requested(self) -> None:
        """Note that the job waits for its next action."""

    def fileno(self) -> int:
        """Return a file descriptor that becomes readable when :meth:`take` has an action."""

    def take(self) -> Any:
        """Return the next action, as JSON.

        Raises:
            Stop: the job must end here.
        """


class Step(msgspec.Struct, frozen=True):
    """What one call of reset or step returned.

    Attributes:
        terminated_type: the type's name as the worker gives it (``bool``, ``numpy bool``, …); so are the others.
        micros: how long the call took, in microseconds.
        layout: the number of the layout of `data`.
        data: the observation's bytes; of a frame its picture, or nothing.
        info: JSON, empty for ``{}``.
        digest: of a frame; else empty.
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
    digest: bytes = b""


class Steps(msgspec.Struct, frozen=True):
    """Consecutive steps. The fields are those of :class:`Step`, with one item for each step. An interactive job sends
    one step at a time.

    Attributes:
        rendered: render() then returned the observation again.
        actions: what a policy in the worker chose, for these steps and perhaps for the one that is under way.
    """

    terminated: list[bool] = []
    truncated: list[bool] = []
    terminated_types: list[str] = []
    truncated_types: list[str] = []
    reward_types: list[str] = []
    rewards: list[float] = []
    micros: list[int] = []
    layouts: list[int] = []
    data: list[memoryview] = []
    infos: list[bytes] = []
    digests: list[bytes] = []
    rendered: list[bool] = []
    actions: list[Any] = []

    def __len__(self) -> int:
        return len(self.rewards)

    def each(self) -> Iterator[Step]:
        """The steps, one by one."""
        columns = (
            *(self.terminated, self.truncated, self.terminated_types, self.truncated_types, self.reward_types),
            *(self.rewards, self.micros, self.layouts, self.data, self.infos, self.digests),
        )
        return itertools.starmap(Step, zip(*columns, strict=True))


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
            The modules that could be imported; none if one has started a thread, after which the worker must not run a
            job.

        Raises:
            WorkerLost: the worker is gone.
        """

    @abstractmethod
    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        """Look modules up without importing them.

        Returns:
            The names in `modules` that are not installed, and if there are any, the names of all installed modules.

        Raises:
            WorkerLost: the worker is gone.
        """

    @abstractmethod
    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        """Run a job until it ends.

        Args:
            job: the job. With ``series``, it may run in the process of the previous job, if that job also had
                ``series`` and left nothing behind. With ``new_process``, it runs in a new process, which later jobs may
                share.
            recorder: receives the job's messages, in the calling thread.
            limits: what the job may use.
            player: chooses the actions of an interactive job, which the recorder also receives.

        Returns:
            Why the job ended, and what it used.

        Raises:
            WorkerLost: the worker itself is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """End the worker and everything in it. A second call does nothing."""


class Driver(ABC):
    """A way to isolate workers. A driver implements :meth:`probe` and :meth:`launch`; the other methods have defaults.

    Attributes:
        name: the value for ``--sandbox``.
        isolation: the level that reports state.
        rank: ``auto`` selects the working driver with the highest rank.
        packages: names of packages that the driver starts by name, such as its worker. A change in them makes verdicts
            stale.
        shares_from: the number of subjects from which on the workers of a run share their memory layout.
    """

    name: str
    isolation: Isolation
    rank: int
    packages: tuple[str, ...] = ()
    shares_from = 2

    @abstractmethod
    def probe(self) -> Availability:
        """Test whether workers can be launched here. Everything that it starts ends before it returns."""

    @cached_property
    def availability(self) -> Availability:
        """The result of the first :meth:`probe`. If the probe raises, the driver does not work."""
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
        """Launch a worker without waiting for it, if the driver supports that. The default launches it in the call.

        Args:
            hash_seed: as for :meth:`launch`.
            limits: as for :meth:`launch`.

        Returns:
            A function that waits until the worker is ready and returns it. It may raise SandboxUnavailable, too.

        Raises:
            SandboxUnavailable: the driver cannot launch it.
        """
        return lambda: self.launch(hash_seed=hash_seed, limits=limits)

    def shared_layout(self) -> Driver:
        """Return a driver that launches many workers faster; by default this driver itself.

        Workers with the same hash seed may share their memory layout, and nothing else. Close the driver after the last
        worker.
        """
        return self

    def with_runtime(self, runtime: str) -> Driver:
        """Return this driver with another container runtime.

        Args:
            runtime: the name of the runtime, such as ``runsc``.

        Raises:
            UsageError: the driver does not run containers.
        """
        raise UsageError(f"--runtime {runtime} requires the docker sandbox, not {self.name}")

    def with_installed(self, packages: Installed) -> Driver:
        """Return this driver with workers that can import the packages of the host.

        By default it is this driver itself, for workers that have their own file system.

        Args:
            packages: the folders of the packages.
        """
        return self

    def image(self) -> str | None:
        """Return the digest of the workers' image, which is part of a verdict's settings.

        Returns:
            The digest, or None if workers run on the host's interpreter.

        Raises:
            SandboxUnavailable: there is no image.
        """
        return None

    def sweep(self) -> None:  # noqa: B027 (most drivers leave nothing)
        """Remove what killed processes left behind. It is fast if there is nothing to remove, and never raises."""

    def close(self) -> None:  # noqa: B027 (most drivers hold nothing)
        """Release the driver's own resources."""


def choose(drivers: list[Driver], name: str) -> Driver:
    """Select a driver by its name, or for ``auto`` the working driver with the highest rank.

    A driver that is selected by its name may not work here (:func:`ensure`).

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
    raise SandboxUnavailable(f"no sandbox is called {name}; choose from {', '.join(d.name for d in ranked)}")


def ensure(driver: Driver) -> None:
    """Check that a driver works here.

    Raises:
        SandboxUnavailable: it does not work; the message has the reason and the next step.
    """
    available = driver.availability
    if not available.works:
        raise SandboxUnavailable(f"the {driver.name} sandbox does not work here: {available.reason}; {available.fix}")


def driver_for(driver: Driver, targets: Iterable[Target]) -> Driver:
    """Return a driver whose workers can import what these targets need.

    Workers can import the packages of the host only if one of the targets is installed there.
    """
    return driver.with_installed(installed()) if any(target.installed for target in targets) else driver
