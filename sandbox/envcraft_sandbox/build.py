"""Build the container image: on any image with Python and pip, or of the running interpreter without any registry."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from envcraft import __version__
from envcraft.errors import SandboxUnavailable

from . import rootfs
from .engine import EngineError, docker, docker_aloud

TAG = f"envcraft-worker:{__version__}"
#: Its value is :func:`digest`: an image of other sources than these is stale.
LABEL = "org.envcraft.worker"
BASE_LABEL = "org.envcraft.base"
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
    for path in [_PACKAGE / "__init__.py", _PACKAGE / "wire.py", *sorted((_PACKAGE / "worker").glob("*.py"))]:
        yield path.relative_to(_PACKAGE.parent).as_posix(), path.read_bytes()


def digest() -> str:
    """SHA-256 over the worker's sources and the recipe of its image."""
    recipe = ((name, (_IMAGE / name).read_bytes()) for name in ("Dockerfile", "requirements.txt"))
    total = hashlib.sha256()
    for name, content in [*worker_sources(), *recipe]:
        total.update(f"{name}\0{len(content)}\0".encode() + content)
    return total.hexdigest()


def build(base: str, say: Say) -> tuple[str, str]:
    """Build the image on `base`, telling progress to `say`, and give its tag and digest.

    Raises SandboxUnavailable, in one sentence.
    """
    docker("version", "--format", "{{.Server.Version}}", timeout=10.0)
    replaced = docker("image", "ls", "--quiet", "--no-trunc", TAG)
    if base == HOST:
        _import_host(say)
    else:
        _build_on(base, say)
    built = docker("image", "inspect", "--format", "{{.Id}}", TAG)
    if replaced and replaced != built:
        # Images of this size must not pile up; one that a container still uses stays.
        with contextlib.suppress(EngineError):
            docker("image", "rm", replaced)
    return TAG, built


def _import_host(say: Say) -> None:
    say(f"reading {sys.executable} and its libraries")
    root = rootfs.collect(list(worker_sources()))
    say(f"importing {len(root)} files")
    entrypoint = [root.python, "-B", "-s", "-P", "-m", "envcraft_sandbox.worker"]
    changes = [
        f"ENTRYPOINT {json.dumps(entrypoint)}",
        f"ENV PYTHONPATH={rootfs.WORKER_ROOT}:{rootfs.LIBRARIES_ROOT}",
        "USER 65534:65534",
        "WORKDIR /tmp",
        f"LABEL {LABEL}={digest()} {BASE_LABEL}={HOST}",
    ]
    options = [word for change in changes for word in ("--change", change)]
    docker_aloud("import", *options, "-", TAG, say=say, feed=root.write)


def _build_on(base: str, say: Say) -> None:
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
    with tempfile.TemporaryDirectory(prefix="envcraft-") as folder:
        context = Path(folder)
        for name, content in worker_sources():
            path = context / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        for name in ("Dockerfile", "requirements.txt"):
            shutil.copy(_IMAGE / name, context)
        say(f"downloading wheels for Python {version}")
        _download(context / "wheels", version, platforms, say)
        labels = ["--label", f"{LABEL}={digest()}", "--label", f"{BASE_LABEL}={base}"]
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


def _download(folder: Path, version: str, platforms: list[str], say: Say) -> None:
    """Download the pinned wheels, with this machine's pip and its settings. Raises SandboxUnavailable."""
    argv = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    argv += ["--only-binary=:all:", "--implementation=cp", f"--python-version={version}"]
    argv += [f"--platform={platform}" for platform in platforms]
    argv += ["--dest", str(folder), "--requirement", str(_IMAGE / "requirements.txt")]
    done = subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    lines = done.stderr.strip().splitlines()
    for line in lines:
        say(line)
    if done.returncode:
        words = lines[-1] if lines else "pip gave no reason"
        raise SandboxUnavailable(f"the wheels cannot be downloaded: {words}; without an index use `--base host`")
