"""The JSON that host and worker exchange: jobs, and the control messages of the fork server and of the zygote.

These types describe dictionaries and do nothing at run time; the type checker holds both sides to them. Times are in
seconds, sizes in bytes.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict


class Project(TypedDict):
    """The files that a file needs besides itself.

    Attributes:
        module: the dotted name of the file; "" for what is installed.
        path: the path of the file; "" for what is installed.
        files: the other files by path, as Base64. Paths have slashes and start at the project's root.
        imports: the folders that imports start from; by default the root.
    """

    module: str
    path: str
    files: dict[str, str]
    imports: NotRequired[list[str]]


#: The text of a file.
SourceTarget = TypedDict(
    "SourceTarget",
    {
        "kind": Literal["source"],
        "source": str,
        "filename": str,
        "class": NotRequired[str | None],
        "kwargs": NotRequired[dict[str, Any]],
        "wrappers": NotRequired[list[str]],
        "project": NotRequired[Project],
    },
)
#: A class, or a function that makes environments, of an installed module.
ModuleTarget = TypedDict(
    "ModuleTarget",
    {
        "kind": Literal["module"],
        "module": str,
        "class": str,
        "kwargs": NotRequired[dict[str, Any]],
        "wrappers": NotRequired[list[str]],
        "project": NotRequired[Project],
    },
)


class RegisteredTarget(TypedDict):
    """An id in Gymnasium's registry."""

    kind: Literal["id"]
    id: str
    kwargs: NotRequired[dict[str, Any]]
    wrappers: NotRequired[list[str]]
    project: NotRequired[Project]


Target = SourceTarget | ModuleTarget | RegisteredTarget


class Contract(TypedDict, total=False):
    """The part of a contract that the worker needs.

    Attributes:
        action: JSON description of the action space; None: the environment's own.
        adapter: wrappers to apply, see :func:`envcraft_protocol.adapters.apply`.
        success: key in `info` that says whether the episode is won.
        sign: an episode without that key is won if its return is positive.
    """

    action: dict[str, Any] | None
    adapter: dict[str, Any] | None
    success: str
    sign: bool


class Policy(TypedDict):
    """Source of a policy that chooses the actions inside the worker."""

    source: str
    filename: str


class Episode(TypedDict):
    """An episode of another instance, or one that runs earlier on the same instance.

    With `lines` the lines of Python that a recorded episode runs are counted.
    """

    seed: int
    actions: list[Any]
    lines: NotRequired[bool]


class ClockShift(TypedDict):
    """A clock that is `offset` seconds ahead and runs at `rate`; rate 0 is the logical clock."""

    offset: float
    rate: float


class Conditions(TypedDict, total=False):
    """How a rollout differs from an ordinary one; a key is absent if there is no difference.

    The host's ``Conditions`` defines the meaning of each.
    """

    fresh: bool
    heap: int
    hash_seed: int
    global_seed: int
    perturb: int
    clock: ClockShift
    again: bool
    before: list[Episode]
    companion: Episode
    render: bool
    reread: bool
    after_end: int
    options: bool
    closed: bool
    unseeded: bool
    reuse: bool
    int32: bool
    python: bool
    unrendered: bool
    recorded: bool


class Pictures(TypedDict):
    """The observations of each episode whose pictures are sent: the `first` ones, and up to number `until` `every` so
    many. Number 0 is that of the reset.
    """

    first: int
    every: int
    until: int


class Job(TypedDict):
    """One job of a worker.

    Attributes:
        seed: of the episode, or of the search.
        actions: of the rollout; of a search the actions that it chooses from.
        max_steps: number of steps at most, of a rollout whose actions are not in the job and of a search.
        options: passed to ``reset``.
        policy: chooses the actions inside the worker. With `actions` these are taken, and the policy says in each
            state what it would do.
        interactive: the host chooses each action (ASK).
        every_step: send each step at once.
        count_waits: measure the episode: count the calls that give up the processor, and the processor time of steps.
        frame: the shape of the uint8 observations that are sent as digests, because no rule looks at them. If the
            contract resizes frames to this shape, frames of any shape are.
        pictures: the frames that are also sent as pictures; by default none.
        columns: whether long frames are digested by columns of pixels, not by rows. By default the memory order of the
            job's first long frame decides.
        marks: line and column, in bytes of UTF-8, of statements in the target's source; the job says which of them were
            reached.
        fields: send the fields of the environment's state after the reset and each step (FIELDS).
        series: the process may run further jobs.
        new_process: the job is the first one of its process.
        search: name of the search.
        path: actions that the search follows first.
        counter: the attribute that counts steps for the search, and the number at which the episode ends.
        limit: length of an episode in steps.
        seconds: time after which the search stops, or the measured episode; after so much processor time no
            recorded episode but the last one starts.
    """

    kind: Literal["describe", "rollout", "search"]
    target: Target
    contract: Contract
    seed: NotRequired[int]
    actions: NotRequired[list[Any]]
    max_steps: NotRequired[int]
    conditions: NotRequired[Conditions]
    options: NotRequired[dict[str, Any]]
    policy: NotRequired[Policy]
    interactive: NotRequired[bool]
    every_step: NotRequired[bool]
    count_waits: NotRequired[bool]
    frame: NotRequired[list[int]]
    pictures: NotRequired[Pictures]
    columns: NotRequired[bool]
    marks: NotRequired[list[list[int]]]
    fields: NotRequired[bool]
    series: NotRequired[bool]
    new_process: NotRequired[bool]
    search: NotRequired[str]
    path: NotRequired[list[Any]]
    counter: NotRequired[tuple[str, int]]
    limit: NotRequired[int]
    seconds: NotRequired[float]


class Fields(TypedDict):
    """Payload of a FIELDS message, which follows a reset or a step.

    Attributes:
        changed: the path, the digest and a short text of each field that is new or differs from the last state.
        gone: the paths of fields that no longer exist.
        lines: the lines of the target's file that the call ran.
    """

    changed: list[list[str]]
    gone: list[str]
    lines: list[int]


class End(TypedDict, total=False):
    """Payload of the END message.

    Attributes:
        steps: calls of step() of every kind: of the episode, of earlier ones, of a companion, of searches.
        reusable: the process offers to run another job.
        waits: the number of calls that gave up the processor, an answer to ``count_waits``.
        busy: the processor time of the steps in microseconds, another one. Of a step that waits all time counts.
        reached: a digit for each of the job's marks, 1 for those that were reached; absent without marks, or if they do
            not fit the source.
    """

    steps: int
    reusable: bool
    waits: int
    busy: int
    reached: str


class JobLimits(TypedDict):
    """The limits that the worker enforces on a job, a part of the host's ``Limits``."""

    memory: int
    cpu: int
    file: int
    disk: int
    descriptors: int
    processes: int


#: A limit whose excess the fork server's watchdog observes.
Exceeded = Literal["memory", "processes", "disk"]


class PreloadRequest(TypedDict):
    """Import modules before any job is forked; the answer is :class:`Preloaded`."""

    op: Literal["preload"]
    modules: list[str]


class FindRequest(TypedDict):
    """Look up modules without importing them; the answer is :class:`Found`."""

    op: Literal["find"]
    modules: list[str]


class JobRequest(TypedDict):
    """Fork a process for a job. Two descriptors travel with it: the job's data socket and the pipe for its output."""

    op: Literal["job"]
    id: int
    limits: JobLimits


class KillRequest(TypedDict):
    """Kill a job's processes."""

    op: Literal["kill"]
    id: int


class DumpRequest(TypedDict):
    """Let a job's process write its Python stack to its output."""

    op: Literal["dump"]
    id: int


#: What the host sends to the fork server.
Request = PreloadRequest | FindRequest | JobRequest | KillRequest | DumpRequest


class About(TypedDict):
    """What a fork server reports when it starts: versions, and the layers that its jobs run under."""

    python: str
    numpy: str
    gymnasium: str
    hash_seed: str
    layers: list[str]
    missing: list[str]


class Ready(TypedDict):
    """The fork server accepts requests."""

    ready: About


class Preloaded(TypedDict):
    """The modules that could be imported."""

    preloaded: list[str]


class Found(TypedDict):
    """The modules that are missing and, if there are any, all top-level modules that are installed."""

    missing: list[str]
    known: list[str]


class Exit(TypedDict):
    """A job's process has ended: its number, wait status, processor time in seconds, and the limit it exceeded."""

    exit: int
    status: int
    cpu: float
    over: Exceeded | None


#: What the fork server sends to the host.
Reply = Ready | Preloaded | Found | Exit


class ForkRequest(TypedDict):
    """Ask the zygote for a fork server whose jobs write below `folder`. Its control socket travels with it."""

    folder: str


class ZygoteReady(TypedDict):
    """The zygote accepts requests."""

    ready: dict[str, Any]


class Forked(TypedDict):
    """The process id of the new fork server. Its pidfd travels with it."""

    forked: int


class ForkRefused(TypedDict):
    """The reason why the zygote cannot fork a fork server."""

    refused: str


#: What the zygote sends to the host.
ZygoteReply = ZygoteReady | Forked | ForkRefused
