"""Resolve the TARGETs of the command line: files, folders, classes of installed packages, registered ids."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

import click

from envcraft.errors import UsageError
from envcraft.model.target import MAX_SOURCE, Kind, Target, kind_of, read_target
from envcraft.text import one_line, plural

#: A file in a folder is an environment if it has a class and names Gymnasium or Gym.
_CLASS = re.compile(rb"^class\s", re.MULTILINE)
_GYMNASIUM = re.compile(rb"\bgym(nasium)?\b")
_SKIPPED_FOLDERS = {"__pycache__", "node_modules", "site-packages", "build", "dist"}


def resolve(path: str, env_class: str | None = None, environments_only: bool = False) -> list[Target]:
    """Find what a TARGET names.

    Args:
        path: a file, a folder, ``package.module:Class`` or a registered id.
        env_class: the class to judge if a file defines several.
        environments_only: skip a file that does not look like an environment; nothing may be left then.

    Raises:
        UsageError: the target does not exist, cannot be read, or holds no environment.
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
            words = "names its class" if kind is Kind.MODULE else "has one class"
            raise UsageError(f"{path} {words}; remove --class {env_class}") from None
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
        raise UsageError(f"{path} holds no environment: no .py file in it defines a class and names gymnasium")
    return found


def environments_below(folder: str, env_class: str | None = None) -> Iterator[Target]:
    """Yield the environments in a folder by path; report the number of skipped files on stderr at the end."""
    skipped = []
    for file in _python_files(folder):
        try:
            target = read_target(file, env_class)
        except UsageError:
            skipped.append(file)
            continue
        if _is_environment(target):
            yield target
        else:
            skipped.append(file)
    if skipped:
        named = ", ".join(one_line(os.path.relpath(file, folder)) for file in skipped[:3])
        more = ", …" if len(skipped) > 3 else ""
        click.echo(
            f"skipped {plural(len(skipped), 'file')} in {one_line(folder)} that "
            f"{'defines' if len(skipped) == 1 else 'define'} no environment class: {named}{more}",
            err=True,
        )


def _is_environment(target: Target) -> bool:
    """Return whether a file looks like an environment, without running it."""
    source = target.source
    return len(source) <= MAX_SOURCE and bool(_CLASS.search(source) and _GYMNASIUM.search(source))


def _python_files(folder: str) -> Iterator[str]:
    from envcraft.corpus.store import is_corpus

    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            # A corpus keeps copies of sources, which are not the folder's own environments.
            if not name.startswith(".") and name not in _SKIPPED_FOLDERS and not is_corpus(Path(parent, name))
        )
        for name in sorted(files):
            path = os.path.join(parent, name)
            # Links count: the snapshots in a Hugging Face cache are links.
            if name.endswith(".py") and os.path.isfile(path):
                yield path
