"""From the TARGETs of the command line to what is judged: files, classes of installed packages, registered ids."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

import click

from envcraft.errors import UsageError
from envcraft.reports import one_line, plural
from envcraft.target import MAX_SOURCE, Kind, Target, kind_of, read_target

#: What a file in a folder must have to be taken for an environment: a class, and Gymnasium by either name.
_CLASS = re.compile(rb"^class\s", re.MULTILINE)
_GYMNASIUM = re.compile(rb"\bgym(nasium)?\b")
_PASSED_OVER = {"__pycache__", "node_modules", "site-packages", "build", "dist"}


def resolve(path: str, env_class: str | None = None, environments_only: bool = False) -> list[Target]:
    """The file at `path`, the environments in that folder, or the class or id of that name. Raises UsageError.

    With `environments_only` a file is held to what a folder's are, and there may be nothing left.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        if (kind := kind_of(path)) is None:
            raise UsageError(
                f"{path} does not exist; give a Python file, a folder with some, package.module:Class or an id like "
                "CartPole-v1"
            ) from None
        if env_class is not None:
            words = "names its class itself" if kind is Kind.MODULE else "has one class"
            raise UsageError(f"{path} {words}: leave out --class {env_class}") from None
        return [Target(path, kind=kind)]
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if stat.S_ISREG(mode):
        target = read_target(path, env_class)
        return [] if environments_only and not _is_environment(target) else [target]
    if not stat.S_ISDIR(mode):
        raise UsageError(f"{path} is neither a file nor a folder; save the environment in a file first")
    found = list(environments_below(path, env_class))
    if not found and not environments_only:
        raise UsageError(f"{path} holds no environment: no .py file below it has a class and names gymnasium")
    return found


def environments_below(folder: str, env_class: str | None = None) -> Iterator[Target]:
    """The environments in a folder, in the order of their paths; at the end stderr has the number of other files."""
    passed_over = []
    for file in _python_files(folder):
        try:
            target = read_target(file, env_class)
        except UsageError:
            passed_over.append(file)
            continue
        if _is_environment(target):
            yield target
        else:
            passed_over.append(file)
    if passed_over:
        named = ", ".join(one_line(os.path.relpath(file, folder)) for file in passed_over[:3])
        more = ", …" if len(passed_over) > 3 else ""
        click.echo(
            f"passed over in {one_line(folder)}, for want of a class, the word gymnasium or a way to read it: "
            f"{plural(len(passed_over), '.py file')} ({named}{more})",
            err=True,
        )


def _is_environment(target: Target) -> bool:
    """Whether a file looks like one, as far as that can be told without running it."""
    source = target.source
    return len(source) <= MAX_SOURCE and bool(_CLASS.search(source) and _GYMNASIUM.search(source))


def _python_files(folder: str) -> Iterator[str]:
    from envcraft.corpus.store import is_corpus

    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            # The sources that a corpus keeps are copies, and none of the folder's own environments.
            if not name.startswith(".") and name not in _PASSED_OVER and not is_corpus(Path(parent, name))
        )
        for name in sorted(files):
            path = os.path.join(parent, name)
            # Links too: the snapshots of a hub's cache hold nothing else.
            if name.endswith(".py") and os.path.isfile(path):
                yield path
