"""What a worker reports about a target's file when it loads it: the class, its spaces and where it is defined."""

from __future__ import annotations

import ast
import os
import sys
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from envcraft.errors import EnvCraftError, Skip
from envcraft.judging.description import Description
from envcraft.judging.driver import Isolation
from envcraft.judging.fit import fitting_contract
from envcraft.judging.job_runner import JobRunner
from envcraft.judging.job_scheduler import Placement
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.model.contract import OPTIONAL, Contract
from envcraft.model.job import JobResult
from envcraft.model.rollout import Rollout
from envcraft.model.target import Kind, Target, imported, nodes, parse, read_known
from envcraft.model.trace import Fault, Trace
from envcraft.model.verdict import Line
from envcraft.spaces.spec import SpaceSpec, read_space
from envcraft.text import one_line, relative

if TYPE_CHECKING:
    from envcraft_protocol.jobs import Job


#: Libraries that do nothing at import except to take time.
WELL_KNOWN = frozenset({
    "PIL", "cv2", "imageio", "jax", "matplotlib", "networkx", "numba", "pandas", "pygame", "pymunk", "scipy", "shapely",
    "skimage", "sklearn", "sympy", "torch", "torchvision",
})  # fmt: skip


class Loaded(msgspec.Struct, frozen=True):
    """The result of loading the file in the worker.

    Attributes:
        description: what the worker reports about the file.
        trace: holds the fault if loading failed.
        end: how the job ended.
    """

    description: Description
    trace: Trace
    end: JobResult


class Facts:
    """The facts of one target. Properties that need the worker load the file when they are first read.

    Attributes:
        env_class: the environment's class, if it is known.
    """

    def __init__(self, target: Target, contract: Contract, runner: JobRunner) -> None:
        self.env_class = target.env_class
        self._target = target
        self._contract = contract
        self._runner = runner
        self._loaded: Loaded | None = None
        #: The spaces that were read last, with their JSON.
        self._spaces: dict[str, tuple[dict[str, Any], SpaceSpec]] = {}

    def load(self) -> Loaded:
        """Load the file in a worker and construct one instance, once.

        Raises:
            WorkerLost: the sandbox failed.
        """
        if self._loaded is None:
            self._loaded = self._runner.retry(self._load)
            description = self._loaded.description
            self._runner.preload(self._shareable(description))
            self.env_class = description.get("class", self.env_class)
        return self._loaded

    @property
    def constructed(self) -> bool:
        """Whether the target was loaded, and its constructor was called."""
        if self._loaded is None:
            return False
        fault = self._loaded.trace.fault
        return (fault.phase if fault is not None else self._loaded.end.phase) != "import"

    def _shareable(self, description: Description) -> list[str]:
        """The modules that the fork server may import once for all jobs, instead of each job.

        They are those that the target has imported: of a file the installed libraries that it names. A fork server that
        is not isolated imports only well-known ones, since a file may name a library because of what it does at import.
        """
        if description.get("effects", {}).get("threads") != 0:
            # A process with threads must not be forked.
            return []
        loaded, isolated = description.get("modules", []), self._runner.isolation is not Isolation.PROCESS
        # Only jobs have the files of the project.
        own = self._target.project.modules if self._target.project is not None else frozenset()
        if self._target.installed:
            return [name for name in loaded if name.partition(".")[0] not in own] if isolated else []
        named = set(imported(self._target.source)) - own
        used = [name for name in loaded if name.partition(".")[0] in named]
        return used if isolated else [name for name in used if name in WELL_KNOWN]

    def _load(self) -> Loaded:
        builder = TraceBuilder(Rollout(0, []), None, None)
        job: Job = {**self.job("describe"), "series": self._runner.series}
        trace = self._runner.result(self._runner.submit(Placement(), job, builder))
        assert trace.end is not None
        return Loaded(builder.description, trace, trace.end)

    def job(self, kind: Literal["describe", "rollout", "search"]) -> Job:
        """A job with the fields that all jobs of the target have."""
        return {
            "kind": kind,
            "target": msgspec.structs.replace(self._target, env_class=self.env_class).for_worker(),
            "contract": self._contract.for_worker(),
        }

    @cached_property
    def class_statement(self) -> str | None:
        """The name that the file's class statement gives the class: `env_class` may be another name of it.

        "" if no statement of the file defines the class; None if the file cannot be loaded.
        """
        description = self.load().description
        if "line" not in description:
            return None
        if "elsewhere" in description:
            return ""
        for node in nodes(parse(self._target.text)):
            if isinstance(node, ast.ClassDef):
                first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
                if first == description["line"]:
                    return node.name
        return ""

    @property
    def source_sha256(self) -> str:
        """The digest of the file that defines the class. For an installed class the worker reports it."""
        reported = self._loaded.description.get("sha256") if self._loaded is not None else None
        return reported if reported and self._target.kind is not Kind.SOURCE else self._target.sha256

    @property
    def module(self) -> str | None:
        """The module of an installed class; lines in findings are lines of its file."""
        reported = self._loaded.description.get("module") if self._loaded is not None else None
        return reported if reported and self._target.kind is not Kind.SOURCE else None

    @property
    def source_file(self) -> str | None:
        """The file of an installed class: that of this machine if it has the same content, else that of the worker."""
        return self._source_file if self._loaded is not None and self._target.kind is not Kind.SOURCE else None

    @cached_property
    def _source_file(self) -> str | None:
        reported, module = self.load().description.get("file"), self.module
        if not reported or not module or os.path.isfile(reported):
            return relative(reported) if reported else None
        # A container has the libraries in a folder of its own.
        below = module.replace(".", "/")
        places = (os.path.join(folder, below + end) for folder in sys.path for end in (".py", "/__init__.py"))
        return relative(next((place for place in places if read_known(place, self.source_sha256)), reported))

    @property
    def installed_source(self) -> bytes:
        """The content of :attr:`source_file`; b"" if this machine does not have the same file."""
        return read_known(self.source_file, self.source_sha256) if self.source_file else b""

    @property
    def observation_space(self) -> SpaceSpec:
        """The space that observations are checked against: the contract's, else the environment's own."""
        return self._space("observation_space", self._contract.observation)

    @property
    def action_space(self) -> SpaceSpec:
        """The space that actions are drawn from.

        Raises:
            Skip: only the package that defines the space can draw from it.
            EnvCraftError: the environment has another space than the contract.
        """
        space = self._space("action_space", self._contract.action)
        if not self.acts_as_promised:
            fits = fitting_contract(self.load().description, self._contract)
            raise EnvCraftError(
                f"the action space is {self._own_action_space}, and the contract {self._contract.name} has {space}; "
                + (f"name the contract that fits: --contract {fits}" if fits else "declare the contract's space")
            )
        if not space.known:
            raise Skip(f"no actions can be drawn from the action space, {space}")
        return space

    @property
    def acts_as_promised(self) -> bool:
        """Whether the environment has the contract's actions; otherwise it would be judged with actions that are not
        its own.
        """
        own, promised = self._own_action_space, self._contract.action
        return own is None or promised is None or own == read_space(promised)

    @property
    def _own_action_space(self) -> SpaceSpec | None:
        """The action space that the environment declares, None before the file is loaded."""
        given = self._loaded.description.get("action_space") if self._loaded is not None else None
        return None if given is None else read_space(given)

    @property
    def renders(self) -> bool:
        """Whether render() must give frames: because the contract or the metadata says so, or, where the contract makes
        it optional, because the class has one.
        """
        promised = self._contract.render
        if promised == OPTIONAL:
            return self.load().description.get("renders", False)
        return promised or "rgb_array" in self.load().description.get("render_modes", ())

    def line_of(self, method: str | None = None) -> Line:
        """Return the line at which the class defines a method, or that of the class if it inherits the method; without
        a method that of the class.
        """
        description = self.load().description
        if method is not None and (line := description.get("lines", {}).get(method)):
            return Line(line)
        note = ""
        if method is not None and (owner := description.get("inherited", {}).get(method)):
            note = f"{method}() is inherited from {owner}"
        elif elsewhere := description.get("elsewhere"):
            note = f"{self.env_class} is {elsewhere}"
        return Line(description.get("line"), note)

    def raised(self, fault: Fault) -> str:
        """The exception of a fault in words; with its file and line if another file than the judged one raises it."""
        if not fault.file:
            return str(fault)
        root = self._target.project.root if self._target.project is not None else ""
        place = f"{one_line(relative(os.path.join(root, fault.file)))} line {fault.file_line}"
        return f"{fault.type} in {place}{f': {fault.message}' if fault.message else ''}"

    def _space(self, name: Literal["observation_space", "action_space"], promised: dict[str, Any] | None) -> SpaceSpec:
        described = promised or self.load().description.get(name)
        if described is None:
            raise Skip(f"the environment could not be constructed, so its {name} is not known")
        read = self._spaces.get(name)
        if read is None or read[0] is not described:
            read = self._spaces[name] = described, read_space(described)
        return read[1]
