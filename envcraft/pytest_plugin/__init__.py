"""# In a test suite, with pytest

Environments judged by pytest, one test a check, each environment in one sandbox run. `pip install envcraft-rl` brings
the plugin; without its options, its marker and its fixture it imports nothing of EnvCraft's and does nothing.

## Files
`pytest --envcraft games/` collects every environment below the folder, one test for each check:

```console
$ pytest --envcraft games/ -v
games/snake.py::source PASSED
games/snake.py::determinism FAILED
```

All of pytest's own works on them: `games/snake.py::determinism`, `-k`, `-x`, `--lf`, `--collect-only`, `-m envcraft`,
`--junit-xml`, xdist's `-n`. A file is an environment when its source, which is parsed and never imported here, imports
gymnasium and has an environment class. A test module (`conftest.py`, `test_*.py`, `*_test.py` and what `python_files`
adds) stays pytest's, **and runs in this process**, as in any run of pytest: use `envcraft validate` on a folder in
which nobody has read those. Nothing else imports an environment file, neither `--doctest-modules` nor the `__init__.py`
of its folder; one that is named on the command line and holds neither an environment nor tests is judged, too, rather
than imported.

## Outcomes
A finding fails its check, and is printed with the usual fix, the reproduction, and the commands that show it again. A
check that cannot say anything about an environment is skipped, with its reason. One that could not judge, or a sandbox
that is not there, is an error with the next step, never a failure of the environment. Findings of severity warning are
pytest warnings of the category `EnvCraftWarning`, so that `-W error::envcraft.pytest_plugin.EnvCraftWarning` makes them
fail. What the checks `source` and `sandbox` find, without which no verdict can be trusted, shows in another test of the
environment when they are not selected.

## Classes
The marker `envcraft` makes a test function into one test for each check of a target. Its body runs where the check
passes:

```python
@pytest.mark.envcraft(target=Snake, contract="gymnasium", checks="api, determinism")
def test_snake(): ...
```

gives `test_snake[source]`, `test_snake[api]`, and so on. `target` is a class, whose file is read and judged, or
whatever `envcraft validate` takes, a path being relative to pytest's root folder. `checks`, `skip`, `contract`,
`budget`, `seed` and `sandbox` may be given besides. On a test class (or as `pytestmark`) the marker goes for those
tests that take the fixture `envcraft`, so that a class can have others.

## The fixture
`envcraft` judges from within a test:

```python
def test_every_level(envcraft):
    envcraft.check("games/snake.py", checks=["api"])        # fails the test as the checks do
    report = envcraft.judge(Snake, budget="quick")          # or gives the report, to be looked at
    assert report.verdict == "pass" and report.steps > 1000
```

Marker and fixture work without `--envcraft`, which only asks for the files.

## Settings
From the strongest: the marker or the call, the command line (`--envcraft-contract` and so on), pytest's own
configuration, and `[tool.envcraft]` of `pyproject.toml`:

```toml
[tool.pytest.ini_options]
envcraft_contract = "arcade"
envcraft_budget = "quick"
envcraft_sandbox = "auto"
envcraft_seed = "0"
envcraft_checks = ["api", "determinism"]
envcraft_skip = []
```

## Reports
Each test that stands for a check has, once it is judged, properties whose names begin with `envcraft_`: `subject`,
`class`, `source_sha256`, `contract`, `budget`, `seed`, `isolation`, `driver`, `steps` (of the whole environment) and
`codes` (of its findings). JUnit XML carries them.
The first test of an environment that runs judges it; the durations that pytest reports are nevertheless each check's
own.

## xdist
The workers of `-n` share results, so that each environment is run once whatever `--dist` is; with `--dist loadfile` no
worker waits for another.
"""

from __future__ import annotations

import inspect
import shutil
import sys
import tempfile
from collections.abc import Generator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .fixture import EnvCraft

#: Options of the command line and of pytest's configuration, each with its help.
SETTINGS = {
    "contract": "what the environments promise",
    "budget": "how much a validation spends: quick, standard or thorough",
    "sandbox": "where the environments run",
    "seed": "same seed, same episodes",
    "checks": "run only these checks, separated by commas, and source, which the others rest on",
    "skip": "leave out these checks, separated by commas",
}
_MARKER = (
    "envcraft(target, checks=None, skip=None, contract=None, budget=None, seed=None, sandbox=None): "
    "judge the environment that target is or names, one test for each check"
)
_SHARED = pytest.StashKey[str]()


class EnvCraftWarning(UserWarning):
    """A finding of severity warning."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("envcraft", "environments judged by EnvCraft")
    group.addoption("--envcraft", action="store_true", help="collect environment files, one test for each check")
    for name, text in SETTINGS.items():
        if name in ("checks", "skip"):
            group.addoption(f"--envcraft-{name}", metavar="A,B", help=text)
            parser.addini(f"envcraft_{name}", text, "args", default=None)
        else:
            group.addoption(f"--envcraft-{name}", metavar=name.upper(), help=text)
            parser.addini(f"envcraft_{name}", text, "string", default=None)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", _MARKER)
    if config.getoption("envcraft"):
        from envcraft.errors import EnvCraftError

        from .collection import Collection
        from .judging import settings

        try:
            config.pluginmanager.register(Collection(settings(config)), "envcraft-collection")
        except EnvCraftError as error:
            raise pytest.UsageError(str(error)) from None


def pytest_unconfigure(config: pytest.Config) -> None:
    if judging := _loaded("judging"):
        judging.close(config)
    if shared := config.stash.get(_SHARED, None):
        shutil.rmtree(shared, ignore_errors=True)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """In xdist's controller: give each worker the folder in which they share results."""
    stash = node.config.stash
    if _SHARED not in stash:
        stash[_SHARED] = tempfile.mkdtemp(prefix="envcraft-")
    node.workerinput["envcraft_shared"] = stash[_SHARED]


# Marker and fixture


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(obj: object) -> None:
    marks = getattr(obj, "pytestmark", None) if inspect.isfunction(obj) else None
    if isinstance(marks, list) and any(mark.name == "envcraft" for mark in marks):
        pytest.mark.usefixtures("envcraft")(obj)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "envcraft" in metafunc.fixturenames and metafunc.definition.get_closest_marker("envcraft"):
        from .fixture import cases

        if found := cases(metafunc.definition):
            metafunc.parametrize("envcraft", found, indirect=True, ids=[case.check for case in found])


@pytest.fixture
def envcraft(request: pytest.FixtureRequest) -> EnvCraft:
    """Judges environments; in a test with the marker `envcraft`, knows what was found."""
    from .fixture import EnvCraft

    return EnvCraft(request)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> None:
    if items := _loaded("items"):
        items.conclude(item)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if items := _loaded("items"):
        items.amend(item, call, report)
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say how far what was judged was isolated, from the reports alone: with xdist the workers judge."""
    subjects: dict[str, dict[str, str]] = {}
    for reports in terminalreporter.stats.values():
        for report in reports:
            properties = dict(getattr(report, "user_properties", ()))
            if path := properties.get("envcraft_subject"):
                subjects[path] = properties
    if subjects and terminalreporter.verbosity >= 0:
        from .words import summary

        terminalreporter.write_line(summary(list(subjects.values())))


def _loaded(name: str) -> Any:
    """A module of the plugin if anything has needed it yet."""
    return sys.modules.get(f"{__name__}.{name}")
