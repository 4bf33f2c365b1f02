"""Libraries that an environment lacks: the cause of each unknown import, and its fix."""

from __future__ import annotations

import ast
import contextlib
import itertools
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.errors import WorkerLost
from envcraft.judging.driver import Isolation
from envcraft.model.classes import defined_classes
from envcraft.model.project import Place, with_project
from envcraft.model.target import Kind, nodes

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Fault

_OLD_NAMES = {"gym": "gymnasium", "pygame_ce": "pygame", "np": "numpy"}
#: Libraries that a file of tests imports, and an environment does without.
_TESTING = ("hypothesis", "pytest")
#: Libraries that environments and the files around them import.
_OTHERS = frozenset({
    "Box2D", "OpenGL", "ale_py", "arcade", "attr", "bs4", "chess", "cleanrl", "d3rlpy", "dm_control", "dm_env",
    "einops", "flax", "gym3", "gymnasium_robotics", "h5py", "highway_env", "hydra", "joblib", "keras", "loguru",
    "lxml", "minigrid", "moviepy", "mpmath", "mujoco", "omegaconf", "opensimplex", "optax", "optuna", "orjson",
    "pettingzoo", "plotly", "polars", "psutil", "pybullet", "pydantic", "pyglet", "ray", "requests", "rich",
    "sb3_contrib", "seaborn", "shimmy", "stable_baselines3", "statsmodels", "supersuit", "tensorboard",
    "tensorboardX", "tensorflow", "tianshou", "torchrl", "tqdm", "transformers", "trimesh", "wandb", "xarray", "yaml",
})  # fmt: skip
#: The words of an ImportError about a library that a package does without until this environment needs it.
_INSTALL = re.compile(r"\binstall", re.IGNORECASE)


def why_unknown(name: str, subject: Subject, known: list[str], shown: str = "", installed: bool = False) -> str:
    """What is wrong with an import, and the next step.

    Args:
        name: the module, which the contract does not allow or the worker does not have.
        subject: the environment.
        known: the modules that are installed, if that was asked.
        shown: the module as a message names it.
        installed: whether the worker has the module.
    """
    contract = subject.contract
    if subject.left_out is not None and name in subject.left_out.modules:
        return (
            f"a file of its project, and the contract {contract.name} is for single files; name --contract "
            f'gymnasium, or set `project = true` in a contract of your own with `base = "{contract.name}"`'
        )
    beside = with_project(subject.target).project
    if beside is not None and name in beside.modules:
        return "a file of its project, which only `envcraft validate` and the audit of its folder judge with it"
    if name.startswith("."):
        return f"which is not a file of its package{near_module(shown, Path(subject.target.path))}"
    if name == "envcraft":
        return (
            "which is not available where environments run; leave it out, or move it and the code that needs "
            'it to another file or below `if __name__ == "__main__":`'
        )
    if name in _TESTING:
        return "which is not available where environments run; move the class to a file that does not import it"
    # A library that the contract names is likelier than another of a name as near.
    near = next(filter(None, (_nearest(name, [*group]) for group in (contract.libraries or (), known))), None)
    if not installed and (place := _elsewhere(name, subject)):
        return place
    if (installed or name in well_known()) and name not in _OLD_NAMES:
        return f"which the contract {contract.name} does not allow; it allows {', '.join(contract.libraries or ())}"
    if name not in _OLD_NAMES and (own := near_module(name, Path(subject.target.path))):
        return f"which is not a known library{own}"
    if near or contract.libraries is not None:
        return f"which is not a known library{f'; did you mean {near}?' if near else ''}"
    return "which is neither installed nor known to EnvCraft; correct the name, or install it if it exists"


def in_package(tree: ast.Module, name: str, line: int) -> str:
    """The name of an import; of one in a line like ``from . import name`` the name after the dots, too."""
    if name.strip("."):
        return name
    imports = (node for node in nodes(tree) if isinstance(node, ast.ImportFrom) and node.lineno == line)
    return name + next((node.names[0].name for node in imports if not node.module), "")


def near_module(name: str, file: Path) -> str:
    """The module of its project that an import in a file may mean, in words to append; "" if none has such a name.

    Args:
        name: the module that was not found, with its package or dots.
        file: the file with the import statement.
    """
    import difflib

    if not all(map(str.isidentifier, name.lstrip(".").split("."))):
        # The worker may name anything, a folder outside the project too.
        return ""
    package, dot, module = name.rpartition(".")
    level = len(name) - len(name.lstrip("."))
    starts = [file.parent.joinpath(*[".."] * (level - 1))] if level else [file.parent, *Place.of(file).roots]
    names: list[str] = []
    for start in starts:
        with contextlib.suppress(OSError):
            inside = start.joinpath(*package[level:].split(".")) if package[level:] else start
            names += [
                each.stem for each in inside.iterdir() if each.suffix == ".py" or (each / "__init__.py").is_file()
            ]
    close = difflib.get_close_matches(module, {*names} - {module, file.stem}, n=1, cutoff=0.7)
    return f"; did you mean {package}{dot}{close[0]}?" if close else ""


def _elsewhere(name: str, subject: Subject) -> str:
    """Say in which folder of the project a module lies that a file's imports do not find, and what helps.

    Args:
        name: the module or package.
        subject: the environment, whose file imports it.

    Returns:
        The words after the module's name; "" if no folder has it.
    """
    from envcraft.judging.installed import is_installed

    file, here = Path(subject.target.path).absolute(), Path.cwd()
    above = [folder for folder in file.parents if folder.is_relative_to(here)]
    # Tests import what is in `src`, or in another folder that their settings put on the path.
    folders = dict.fromkeys([*above, here, here / "src", *(Path(each).absolute() for each in sys.path)])
    for folder in (each for each in folders if each not in (file.parent, Place.of(file).root)):
        modules = (folder / f"{name}.py", *itertools.islice(folder.glob(f"{name}/*.py"), 1))
        if any(map(os.path.isfile, modules)) and not is_installed(folder):
            where = "the working directory" if folder == here else os.path.relpath(folder)
            return f"which is not beside the file but in {where}; {_way_to(folder, where, file, subject)}"
    return ""


def _way_to(folder: Path, where: str, file: Path, subject: Subject) -> str:
    """Say how a file's imports can find what is in a folder, whose place a message names."""
    inner = [each for each in reversed(file.parents) if each.is_relative_to(folder) and each != folder]
    parts = [*(each.name for each in inner), *([] if file.stem == "__init__" else [file.stem])]
    if not inner or not all(map(str.isidentifier, parts)):
        install = ", or install it beside EnvCraft" if subject.contract.libraries is None else ""
        return f"move the class to a file in {where}{install}"
    target = subject.target
    classes = [target.env_class] if target.env_class else defined_classes(target.source)
    command = f"`envcraft validate {'.'.join(parts)}:{classes[0] if len(classes) == 1 else 'CLASS'}`"
    start = "" if folder == Path.cwd() else f"in {where}, "
    plain = [os.path.relpath(each) for each in inner if not (each / "__init__.py").is_file()]
    every = f"{' and '.join(plain)} {'has' if len(plain) == 1 else 'have'} an __init__.py"
    return f"{start}{command} finds it, and every command does if {every}"


def ask_for_dependency(subject: Subject, fault: Fault) -> None:
    """Raise WorkerLost if an installed package needs a library that is missing."""
    if subject.target.kind is Kind.SOURCE:
        return
    library = fault.module.partition(".")[0]
    if library and fault.type == "ModuleNotFoundError" and library in subject.find_modules([library])[0]:
        raise WorkerLost(f"{subject.target.path} needs {library}, which is not installed{installation_hint(subject)}")
    advised = fault.type == "ImportError" and not library and _INSTALL.search(fault.message)
    if advised or fault.type == "gymnasium.error.DependencyNotInstalled":
        raise WorkerLost(f"{(words := fault.message.rstrip('. '))}{installation_hint(subject, words)}")


def installation_hint(subject: Subject, message: str = "") -> str:
    """How to give the worker a package that it lacks, as far as a message does not say it."""
    if subject.isolation is Isolation.CONTAINER:
        return "; add the package to the image with `envcraft sandbox build --packages FILE`, or use another --sandbox"
    step = "" if "pip install" in message else "; install the package beside EnvCraft"
    return f"{step}, then validate again"


def well_known() -> frozenset[str]:
    """The libraries that exist for certain, so that a machine that lacks one is no defect of the environment."""
    from envcraft.judging.facts import WELL_KNOWN

    return WELL_KNOWN | _OTHERS


def is_on_host(name: str) -> bool:
    """Whether this interpreter has a library that a worker may lack, without importing it."""
    from importlib.machinery import PathFinder

    folders = [each for each in sys.path if Path(each).name in ("site-packages", "dist-packages")]
    return name not in (*_TESTING, "envcraft") and PathFinder.find_spec(name, folders) is not None


def is_standard(name: str) -> bool:
    """Whether a module belongs to the standard library."""
    return name in sys.stdlib_module_names


def _nearest(name: str, known: list[str]) -> str | None:
    if name in _OLD_NAMES:
        return _OLD_NAMES[name]
    # Imported late: it is slow, and most files import known modules only.
    import difflib

    close = difflib.get_close_matches(name, [each for each in known if each != name], n=1, cutoff=0.75)
    return close[0] if close else None
