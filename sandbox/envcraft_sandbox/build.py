"""Build the container image on an image with Python and pip, or from the running interpreter."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import SandboxUnavailable
from envcraft.version import __version__

from . import engine, leftovers
from .engine import EngineError
from .packages import Package

if TYPE_CHECKING:
    from docker import APIClient

    from . import rootfs

TAG = f"envcraft-worker:{__version__}"
#: Its value is :func:`digest`, which shows whether an image is stale.
LABEL = "org.envcraft.worker"
BASE_LABEL = "org.envcraft.base"
#: The requirements of ``--packages``, separated by blanks.
PACKAGES_LABEL = "org.envcraft.packages"
DEFAULT_BASE = "python:3.11-slim"
#: The base that means the running interpreter.
HOST = "host"

_PACKAGE = Path(__file__).parent
_IMAGE = _PACKAGE / "image"
_PROGRAM = (
    "import json, platform, sys; from importlib.util import find_spec; "
    "print(json.dumps([sys.version_info[:2], platform.machine(), platform.libc_ver(), find_spec('pip') is not None]))"
)
_PROGRAM_SECONDS = 60.0
#: Without an answer from the engine, in seconds: it unpacks an image before it answers.
_BUILD_SECONDS = 600.0
_BLOCK = 1 << 20
_OLDEST_PYTHON = (3, 11)
_OTHER_BASE = "choose a base with Python 3.11 or later, pip, glibc and a shell, or `--base host`"

Say = Callable[[str], None]


def worker_sources() -> Iterator[tuple[str, bytes]]:
    """The worker's files, by the path below the folder that PYTHONPATH names."""
    folders = (_PACKAGE / "worker", _PACKAGE.parent / "envcraft_protocol")
    own = [path for folder in folders for path in sorted(folder.glob("*.py"))]
    for path in [_PACKAGE / "__init__.py", *own]:
        yield path.relative_to(_PACKAGE.parent).as_posix(), path.read_bytes()


def digest(packages: str = "") -> str:
    """SHA-256 over the worker's sources and the recipe of its image; `packages` is the value of PACKAGES_LABEL."""
    # Slow to import, and every driver loads this module.
    import hashlib

    recipe = ((name, (_IMAGE / name).read_bytes()) for name in ("Dockerfile", "requirements.txt"))
    total = hashlib.sha256()
    for name, content in [*worker_sources(), *recipe, ("packages", packages.encode())]:
        total.update(f"{name}\0{len(content)}\0".encode() + content)
    return total.hexdigest()


class Built(msgspec.Struct, frozen=True):
    """An existing image: its id (the digest of its configuration), and what its labels say about its sources."""

    id: str
    digest: str
    packages: str

    def check(self) -> None:
        """Raises EngineError if the image was built from other sources than the installed ones."""
        if self.digest != digest(self.packages):
            again = f" --packages FILE`, FILE naming {self.packages}" if self.packages else "`"
            reason = f"the image {TAG} was built from other sources than these"
            raise EngineError(reason, f"run `envcraft sandbox build{again}")


def find() -> Built:
    """Look for the image. Raises EngineError."""
    connection = engine.client()
    try:
        with engine.errors():
            image = connection.inspect_image(TAG)
    except engine.NotFoundError:
        raise EngineError(f"the image {TAG} is not built", "run `envcraft sandbox build`") from None
    labels = image["Config"]["Labels"] or {}
    return Built(image["Id"], labels.get(LABEL, ""), labels.get(PACKAGES_LABEL, ""))


def build(base: str, say: Say, packages: Sequence[Package] = ()) -> tuple[str, str]:
    """Build the image on `base` with `packages`.

    Args:
        base: the base image, or `HOST`.
        say: receives each line of progress.
        packages: additional libraries.

    Returns:
        The image's tag and digest.

    Raises:
        SandboxUnavailable: the engine or the base cannot do it.
        UsageError: the packages are not available.
    """
    connection = engine.client(_BUILD_SECONDS)
    with engine.errors():
        replaced = [image["Id"] for image in connection.images(TAG)]
    if base == HOST:
        _import_host(connection, packages, say)
    else:
        _build_on(connection, base, packages, say)
    built = find().id
    for old in replaced:
        if old != built:
            # Old images would fill the disk. The engine keeps one that a container still uses.
            with contextlib.suppress(EngineError), engine.errors():
                connection.remove_image(old)
    return TAG, built


def _labels(base: str, packages: Sequence[Package]) -> dict[str, str]:
    named = " ".join(sorted(str(package) for package in packages))
    return {LABEL: digest(named), BASE_LABEL: base, PACKAGES_LABEL: named}


def _import_host(connection: APIClient, packages: Sequence[Package], say: Say) -> None:
    # Only a build needs this module.
    from . import rootfs

    say(f"reading {sys.executable} and its libraries")
    root = rootfs.collect(list(worker_sources()), packages)
    say(f"importing {len(root)} files")
    entrypoint = [root.python, "-B", "-s", "-P", "-m", "envcraft_sandbox.worker"]
    changes = [
        f"ENTRYPOINT {json.dumps(entrypoint)}",
        f"ENV PYTHONPATH={rootfs.WORKER_ROOT}:{rootfs.LIBRARIES_ROOT}",
        "USER 65534:65534",
        "WORKDIR /tmp",
        *(f"LABEL {key}={json.dumps(value)}" for key, value in _labels(HOST, packages).items()),
    ]
    repository, _, tag = TAG.partition(":")
    with engine.errors(), _blocks(root) as blocks:
        answer = connection.import_image(blocks, repository, tag, changes=changes, stream_src=True)
    for line in engine.progress(map(json.loads, answer.splitlines())):
        say(line)


@contextlib.contextmanager
def _blocks(root: rootfs.Root) -> Iterator[Iterator[bytes]]:
    """The tar stream of a root file system, block by block, while a thread writes it."""
    reading, writing = os.pipe()

    def write() -> None:
        # The engine that refuses the image closes the other end.
        with contextlib.suppress(BrokenPipeError), open(writing, "wb") as stream:
            root.write(stream)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        with open(reading, "rb") as stream:
            yield iter(lambda: stream.read(_BLOCK), b"")
    finally:
        writer.join()


def _build_on(connection: APIClient, base: str, packages: Sequence[Package], say: Say) -> None:
    try:
        with engine.errors():
            connection.inspect_image(base)
    except engine.NotFoundError:
        say(f"pulling {base}")
        try:
            with engine.errors():
                from docker.utils import parse_repository_tag

                repository, tag = parse_repository_tag(base)
                events = connection.pull(repository, tag or "latest", stream=True, decode=True)
            for line in engine.progress(events):
                say(line)
        except EngineError as error:
            reason = f"{base} cannot be pulled ({error.reason})"
            raise EngineError(reason, "without a registry use `--base host`") from None
    version, platforms = _platforms(connection, base)
    with tempfile.TemporaryDirectory(prefix="build-", dir=leftovers.folder()) as folder:
        context = Path(folder)
        for name, content in worker_sources():
            path = context / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        for name in ("Dockerfile", "requirements.txt"):
            shutil.copy(_IMAGE / name, context)
        (context / "packages.txt").write_text("".join(f"{package}\n" for package in packages))
        say(f"downloading wheels for Python {version}")
        _download(context, version, platforms, say)
        say(f"building {TAG} on {base}")
        try:
            with engine.errors():
                events = connection.build(
                    path=folder,
                    tag=TAG,
                    buildargs={"BASE": base},
                    labels=_labels(base, packages),
                    network_mode="none",
                    forcerm=True,
                    decode=True,
                )
            for line in engine.progress(events):
                say(line)
        except EngineError as error:
            raise EngineError(f"{TAG} cannot be built on {base} ({error.reason})", _OTHER_BASE) from None


def _platforms(connection: APIClient, base: str) -> tuple[str, list[str]]:
    """The Python version of an image, and the wheel platforms that it accepts. Raises EngineError."""
    try:
        answer = _output(connection, base, ["-c", _PROGRAM])
        version, machine, (libc, release), pip = json.loads(answer)
    except (EngineError, ValueError) as error:
        reason = error.reason if isinstance(error, EngineError) else engine.one_line(answer)
        raise EngineError(f"{base} does not run python3 ({reason})", _OTHER_BASE) from None
    if tuple(version) < _OLDEST_PYTHON or not pip or libc != "glibc":
        found = f"Python {version[0]}.{version[1]}, {libc or 'another C library'}, {'with' if pip else 'without'} pip"
        raise EngineError(f"{base} has {found}", _OTHER_BASE)
    minors = range(5, int(release.split(".")[1]) + 1)
    return f"{version[0]}.{version[1]}", [f"manylinux_2_{minor}_{machine}" for minor in minors]


def _output(connection: APIClient, image: str, arguments: list[str]) -> str:
    """What ``python3`` with these arguments prints in a container of the image. Raises EngineError."""
    with engine.errors():
        host = connection.create_host_config(network_mode="none", log_config={"Type": "json-file", "Config": {}})
        made = connection.create_container(
            image, arguments, entrypoint=["python3"], host_config=host, use_config_proxy=False
        )
        try:
            connection.start(made)
            connection.wait(made, timeout=_PROGRAM_SECONDS)
            output: bytes = connection.logs(made)
        finally:
            connection.remove_container(made, force=True)
    return output.decode(errors="replace")


def _download(context: Path, version: str, platforms: list[str], say: Say) -> None:
    """Download the wheels of ``requirements.txt`` and ``packages.txt``, and what the latter require, with this
    machine's pip and its settings. Raises SandboxUnavailable.
    """
    argv = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    argv += ["--only-binary=:all:", "--implementation=cp", f"--python-version={version}"]
    argv += [f"--platform={platform}" for platform in platforms]
    argv += ["--dest", str(context / "wheels")]
    for name in ("requirements.txt", "packages.txt"):
        argv += ["--requirement", str(context / name)]
    done = subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    lines = done.stderr.strip().splitlines()
    for line in lines:
        say(line)
    if done.returncode:
        words = lines[-1] if lines else "pip gave no reason"
        raise SandboxUnavailable(f"the wheels cannot be downloaded: {words}; without an index use `--base host`")
