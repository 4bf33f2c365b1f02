"""``envcraft new``: write a small environment that passes, with its test, as a starting point."""

from __future__ import annotations

import contextlib
import importlib.resources
import keyword
import os
import re
import shlex
import sys
from pathlib import Path

import click

from envcraft.cli import completion
from envcraft.cli.configured import PartlyConfigured
from envcraft.contracts.builtin import ARCADE, GYMNASIUM
from envcraft.contracts.lookup import contract_named
from envcraft.errors import UsageError
from envcraft.files import refuse_file
from envcraft.model.contract import Contract

#: What the templates call the class and the module.
_CLASS, _MODULE = "NewGame", "new_game"
_FILES = (f"{_MODULE}.py", f"test_{_MODULE}.py")
#: Modules that the templates import, and names that pytest takes for its own.
_TAKEN = {*sys.stdlib_module_names, "gymnasium", "numpy", "pytest", "conftest", "envcraft"}
_WORDS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


@click.command(cls=PartlyConfigured)
@click.argument("name")
@click.option(
    "--contract",
    default="arcade",
    show_default=True,
    metavar="NAME",
    shell_complete=completion.contracts,
    help="The contract of the environment.",
)
@click.option(
    "--folder",
    default="",
    metavar="DIR",
    shell_complete=completion.folders,
    help="Write the files into this folder instead of the working directory.",
)
def new(name: str, contract: str, folder: str) -> None:
    """Write a small environment that passes, and its test.

    NAME is the name of the class (FruitCatch) or of the file (fruit_catch).
    """
    promised = contract_named(contract)
    module, env_class = names(name)
    written = _write(_texts(promised, module, env_class), folder)
    for path in written:
        click.echo(f"wrote {path}")
    game, test = (shlex.quote(path) for path in written)
    option = "" if promised.name == ARCADE.name else f" --contract {shlex.quote(promised.name)}"
    click.echo(f"\nEdit it, then run\n  envcraft validate {game}{option}\n  pytest {test}")


def names(name: str) -> tuple[str, str]:
    """Return the module and class names of an environment. Raises UsageError with a name that would work."""
    module = _WORDS.sub("_", name).lower()
    env_class = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    if not name.isidentifier() or name.startswith("_") or any(map(keyword.iskeyword, (name, module, env_class))):
        folder, _, last = module.removesuffix(".py").rpartition("/")
        near = "_".join(re.findall(r"[^\W_]+", last))
        near = near if near.isidentifier() and near != module else f"game_{near}".rstrip("_")
        where = f" --folder {shlex.quote(name.rpartition('/')[0])}" if folder else ""
        raise UsageError(f"{name!r} is not a valid class name; try `envcraft new {near}{where}`")
    for_pytest = module.startswith("test_") or module.endswith("_test")
    if module in _TAKEN or for_pytest:
        near = f"{module.removeprefix('test_').removesuffix('_test')}_game"
        why = "is a name of pytest's for tests" if for_pytest else "would hide another module"
        raise UsageError(f"{module}.py {why}; try `envcraft new {near}`")
    return module, env_class


def _texts(contract: Contract, module: str, env_class: str) -> dict[str, str]:
    """Fill in a contract's template, by file name. Raises UsageError if the contract has none."""
    templates = {entry.name: entry for entry in (importlib.resources.files("envcraft") / "templates").iterdir()}
    if contract.name not in templates:
        nearest = ARCADE if contract.action == ARCADE.action else GYMNASIUM
        raise UsageError(
            f"the contract {contract.name} has no template; start with --contract {nearest.name}, "
            f"change the spaces, and validate with --contract {contract.name}"
        )
    texts = {}
    for file in _FILES:
        text = (templates[contract.name] / file).read_text("utf-8")
        if re.search(rf"\b{env_class}\b", text):
            raise UsageError(f"the template uses the name {env_class} itself; try `envcraft new {env_class}Game`")
        texts[file.replace(_MODULE, module)] = text.replace(_CLASS, env_class).replace(_MODULE, module)
    return texts


def _write(texts: dict[str, str], folder: str) -> list[str]:
    """Write all files or none. Raises UsageError if one exists."""
    paths = {os.path.join(folder, file): text for file, text in texts.items()}
    for path in paths:
        if os.path.lexists(path):
            raise UsageError(f"{path} exists; nothing was written. Choose another name or a --folder")
    refuse_file(folder)
    written: list[str] = []
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        for path, text in paths.items():
            with open(path, "x", encoding="utf-8") as stream:
                written.append(path)
                stream.write(text)
    except OSError as error:
        for path in written:
            with contextlib.suppress(OSError):
                os.unlink(path)
        raise UsageError(
            f"{error.filename or os.path.abspath(folder or os.curdir)} cannot be written: {error.strerror}"
        ) from None
    return written
