"""Build the container image: on any image with Python and pip, or of the running interpreter without any registry."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec

from envcraft import __version__
from envcraft.errors import SandboxUnavailable

from . import leftovers
from .engine import EngineError, docker, docker_aloud
from .packages import Package

TAG = f"envcraft-worker:{__version__}"
#: Its value is :func:`digest`: an image of other sources than these is stale.
LABEL = "org.envcraft.worker"
BASE_LABEL = "org.envcraft.base"
#: What ``--packages`` added, as a requirements file would say it, separated by blanks.
PACKAGES_LABEL = "org.envcraft.packages"
DEFAULT_BASE = "python:3.11-slim"
#: The base that stands for the running interpreter.
HOST = "host"

_PACKAGE = Path(__file__).parent
_IMAGE = _PACKAGE / "image"
_ASK = (
    "import json, platform, sys; from importlib.util import find_spec; "
    "print(json.dumps([sys.version_info[:2], platform.machine(), platform.libc_ver(), find_spec('pip') is not None]))"
)
_OLDEST_PYTHON = (3, 11)
_OTHER_BASE = "choose a base with Python 3.11 or later, pip, glibc and a shell, or `--base host`"

Say = Callable[[str], None]


def worker_sources() -> Iterator[tuple[str, bytes]]:
    """The worker's files, by the path below the folder that PYTHONPATH names."""
    folders = (_PACKAGE / "worker", _PACKAGE.parent / "envcraft_runtime")
    own = [path for folder in folders for path in sorted(folder.glob("*.py"))]
    for path in [_PACKAGE / "__init__.py", _PACKAGE / "wire.py", *own]:
        yield path.relative_to(_PACKAGE.parent).as_posix(), path.read_bytes()


def digest(packages: str = "") -> str:
    """SHA-256 over the worker's sources and the recipe of its image; `packages` is the value of PACKAGES_LABEL."""
    # Slow to import, and loaded with whichever driver is wanted.
    import hashlib

    recipe = ((name, (_IMAGE / name).read_bytes()) for name in ("Dockerfile", "requirements.txt"))
    total = hashlib.sha256()
    for name, content in [*worker_sources(), *recipe, ("packages", packages.encode())]:
        total.update(f"{name}\0{len(content)}\0".encode() + content)
    return total.hexdigest()


class Built(msgspec.Struct, frozen=True):
    """An image that is there: its id (the digest of its configuration), and what its labels say it was made of."""

    id: str
    digest: str
    packages: str

    def check(self) -> None:
        """Raises EngineError where it was made of other sources than these."""
        if self.digest != digest(self.packages):
            again = f" --packages FILE`, FILE naming {self.packages}" if self.packages else "`"
            reason = f"the image {TAG} was built from other sources than these"
            raise EngineError(reason, f"run `envcraft sandbox build{again}")


def find() -> Built:
    """Look for the image. Raises EngineError."""
    try:
        told = docker("image", "inspect", "--format", "{{.Id}} {{json .Config.Labels}}", TAG)
    except EngineError as error:
        if "no such image" not in error.reason.lower():
            raise
        raise EngineError(f"the image {TAG} is not built", "run `envcraft sandbox build`") from None
    name, _, labels = told.partition(" ")
    found = json.loads(labels) or {}
    return Built(name, found.get(LABEL, ""), found.get(PACKAGES_LABEL, ""))


def build(base: str, say: Say, packages: Sequence[Package] = ()) -> tuple[str, str]:
    """Build the image on `base` with `packages`, telling progress to `say`, and give its tag and digest.

    Raises SandboxUnavailable, in one sentence, and UsageError where `packages` cannot be had.
    """
    docker("version", "--format", "{{.Server.Version}}", timeout=10.0)
    replaced = docker("image", "ls", "--quiet", "--no-trunc", TAG)
    if base == HOST:
        _import_host(packages, say)
    else:
        _build_on(base, packages, say)
    built = docker("image", "inspect", "--format", "{{.Id}}", TAG)
    if replaced and replaced != built:
        # Images of this size must not pile up; one that a container still uses stays.
        with contextlib.suppress(EngineError):
            docker("image", "rm", replaced)
    return TAG, built


def _labels(base: str, packages: Sequence[Package]) -> dict[str, str]:
    named = " ".join(sorted(str(package) for package in packages))
    return {LABEL: digest(named), BASE_LABEL: base, PACKAGES_LABEL: named}


def _import_host(packages: Sequence[Package], say: Say) -> None:
    # Whoever only looks for the image needs none of what makes one.
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
    options = [word for change in changes for word in ("--change", change)]
    docker_aloud("import", *options, "-", TAG, say=say, feed=root.write)


def _build_on(base: str, packages: Sequence[Package], say: Say) -> None:
    try:
        docker("image", "inspect", base)
    except EngineError:
        say(f"pulling {base}")
        try:
            docker_aloud("pull", base, say=say)
        except EngineError as error:
            reason = f"{base} cannot be pulled ({error.reason})"
            raise EngineError(reason, "without a registry use `--base host`") from None
    version, platforms = _ask(base)
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
        labels = [word for key, value in _labels(base, packages).items() for word in ("--label", f"{key}={value}")]
        say(f"building {TAG} on {base}")
        options = ["--force-rm", "--network", "none", "--build-arg", f"BASE={base}", *labels, "--tag", TAG]
        try:
            docker_aloud("build", *options, str(context), say=say)
        except EngineError as error:
            raise EngineError(f"{TAG} cannot be built on {base} ({error.reason})", _OTHER_BASE) from None


def _ask(base: str) -> tuple[str, list[str]]:
    """The Python version of an image, and the wheel platforms that it takes. Raises EngineError."""
    run = ["run", "--rm", "--network", "none", "--entrypoint", "python3", base, "-c", _ASK]
    try:
        told = docker(*run, timeout=60.0)
    except EngineError as error:
        raise EngineError(f"{base} does not run python3 ({error.reason})", _OTHER_BASE) from None
    version, machine, (libc, release), pip = json.loads(told)
    if tuple(version) < _OLDEST_PYTHON or not pip or libc != "glibc":
        found = f"Python {version[0]}.{version[1]}, {libc or 'another C library'}, {'with' if pip else 'without'} pip"
        raise EngineError(f"{base} has {found}", _OTHER_BASE)
    minors = range(5, int(release.split(".")[1]) + 1)
    return f"{version[0]}.{version[1]}", [f"manylinux_2_{minor}_{machine}" for minor in minors]


def _download(context: Path, version: str, platforms: list[str], say: Say) -> None:
    """Download the wheels of ``requirements.txt`` and ``packages.txt`` and of what the latter need, with this machine's
    pip and its settings. Raises SandboxUnavailable.
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
