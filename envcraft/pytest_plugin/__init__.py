"""# In a test suite, with pytest

The plugin makes one pytest test of each check; all checks of an environment share one sandbox run. `pip install
pytest envcraft-rl` installs pytest and the plugin. Without its options, marker or fixture it does nothing.

## Files
`pytest --envcraft games/` collects every environment in the folder, with one test for each check:

```console
$ pytest --envcraft games/ -v
games/snake.py::source PASSED
games/snake.py::determinism FAILED
```

pytest's own features work: `games/snake.py::determinism`, `-k`, `-x`, `--lf`, `--collect-only`, `-m envcraft`,
`--junit-xml`, xdist's `-n`. As for `envcraft validate`, a file is an environment if its source shows that it defines a
subclass of `gymnasium.Env`, also through other files of its project. The plugin parses these and imports none. A test
module (`conftest.py`, `test_*.py`, `*_test.py` and the patterns of `python_files`) belongs to pytest **and runs in this
process**, as in any run of pytest: for a folder whose test modules nobody has read, use `envcraft validate`. Nothing
else imports an environment file, neither `--doctest-modules` nor the `__init__.py` of its folder. A file that is named
on the command line and holds neither an environment nor tests is judged and not imported. A corpus is not
collected: `envcraft audit` judges it.

## Outcomes
A finding fails its check. pytest prints it with the usual fix, the reproduction, and the commands that show it again. A
check that does not apply is skipped with its reason. A check that leaves its question open is also skipped, and its
reason begins with "undecided". A line above pytest's own summary counts the environments that passed, failed or are
undecided, also under `-q`; if several tests judge an environment, its worst outcome counts. A check that could not
judge is an error with the next step, never a failure of the environment. If the sandbox does not work, `pytest
--envcraft` ends with one error, and no test runs.

Findings of severity warning are pytest warnings of the category `EnvCraftWarning`:
`-W error::envcraft.pytest_plugin.EnvCraftWarning` turns them into failures. The severities of `pyproject.toml` and
comments such as `# envcraft: ignore[EC203] reason` apply as in [`envcraft validate`](severity.md). The checks `source`
and `sandbox` always run, because every verdict depends on them. If they are not selected, another test of the
environment shows their findings.

## Classes
The marker `envcraft` turns a test function into one test for each check of a target. Its body runs if the check
passes:

```python
@pytest.mark.envcraft(target=Snake, contract="gymnasium", checks="api, determinism")
def test_snake(): ...
```

This gives `test_snake[source]`, `test_snake[api]`, and so on. `target` is a class, whose file is judged, or a TARGET of
`envcraft validate`; a path is relative to pytest's root folder. `checks`, `skip`, `contract`, `budget`, `seed`,
`sandbox` and `time_limit` are optional. On a test class, or as `pytestmark`, the marker applies to the tests that take
the fixture `envcraft`.

[Strategies and a state machine](testing.md) test properties that only you know.

## The fixture
The fixture `envcraft` judges from within a test:

```python
def test_snake(envcraft):
    report = envcraft.check("games/snake.py", checks=["api"])  # if a check fails, so does the test, with the findings
    assert report.steps > 1000

def test_only_what_is_known(envcraft):
    report = envcraft.judge(Snake, budget="quick")  # returns the report also if a check fails
    assert {finding.code for check in report.checks for finding in check.findings} <= {"EC805"}
```

An undecided check fails the test only under `strict`. The line above pytest's summary counts its environment.

The marker and the fixture work without `--envcraft`, which only collects files.

## Settings
In order of precedence: the marker or the call, the command line (`--envcraft-contract` and so on), pytest's
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

All other settings of [`envcraft validate`](options.md#settings) in `[tool.envcraft]` apply, too, such as `select`,
`ignore`, `exclude`, `baseline`, `strict`, `kwargs` and `policy`. Only `class`, `workers`, `exitfirst`,
`environments-only` and those of the report (`format`, `output`, `report`, `quiet`, `verbose`, `exit-zero`) do not,
because pytest itself selects tests, runs them and reports on them.

## Reports
The test of a check has properties, which JUnit XML contains. Their names begin with `envcraft_`: `subject`, `class`,
`source_sha256`, `contract`, `budget`, `seed`, `isolation`, `driver`, `steps` and `outcome` (of the whole environment),
and `codes` (of its findings). The first test of an environment judges it; the durations that pytest reports are still
those of each check.

## xdist
The workers of `-n` share results, so each environment runs once under every `--dist`. With `--dist loadfile` no
worker waits for another.
"""

from __future__ import annotations

import inspect
import itertools
import shutil
import sys
import tempfile
from collections.abc import Generator
from typing import TYPE_CHECKING, Any

import pytest

from envcraft.pytest_plugin.settings import SETTINGS, EnvCraftWarning

if TYPE_CHECKING:
    from envcraft.pytest_plugin.fixture import EnvCraft

__all__ = ["EnvCraftWarning"]

_MARKER = (
    "envcraft(target, checks=None, skip=None, contract=None, budget=None, seed=None, sandbox=None, time_limit=None): "
    "validate the environment target, with one test for each check"
)
_SHARED = pytest.StashKey[str]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("envcraft", "validation of environments by EnvCraft")
    group.addoption("--envcraft", action="store_true", help="collect environment files, one test for each check")
    for name, text in SETTINGS.items():
        if name in ("checks", "skip"):
            group.addoption(f"--envcraft-{name}", metavar="A,B", help=text)
            parser.addini(f"envcraft_{name}", text, "args", default=None)
        else:
            metavar = "SECONDS" if name == "time_limit" else name.upper()
            group.addoption(f"--envcraft-{name.replace('_', '-')}", metavar=metavar, help=text)
            parser.addini(f"envcraft_{name}", text, "string", default=None)


@pytest.hookimpl(wrapper=True)
def pytest_load_initial_conftests(parser: pytest.Parser, args: list[str]) -> Generator[None]:
    """Suggest an option for a misspelt one. pytest's own error, which comes later, suggests none."""
    yield
    if not any(arg.startswith("--envcraft-") for arg in args):
        return
    # A conftest.py, loaded by now, may have added an option of this kind.
    for arg in parser.parse_known_and_unknown_args(args)[1]:
        if arg.startswith("--envcraft-"):
            from envcraft.registry import did_you_mean

            known = [f"--envcraft-{name.replace('_', '-')}" for name in SETTINGS]
            words = did_you_mean(arg.partition("=")[0], known)
            raise pytest.UsageError(f"there is no option {words} All other settings are set in [tool.envcraft]")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", _MARKER)
    if config.getoption("envcraft"):
        from envcraft.errors import EnvCraftError
        from envcraft.pytest_plugin.collection import Collection

        try:
            config.pluginmanager.register(Collection(config), "envcraft-collection")
        except EnvCraftError as error:
            raise pytest.UsageError(str(error)) from None


def pytest_unconfigure(config: pytest.Config) -> None:
    if judging := _loaded("judging"):
        judging.close(config)
    if shared := config.stash.get(_SHARED, None):
        shutil.rmtree(shared, ignore_errors=True)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """In xdist's controller, give each worker the folder of shared results."""
    stash = node.config.stash
    if _SHARED not in stash:
        stash[_SHARED] = tempfile.mkdtemp(prefix="envcraft-")
    node.workerinput["envcraft_shared"] = stash[_SHARED]


# Marker and fixture


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(obj: object) -> None:
    kind = obj if inspect.isclass(obj) else type(obj)
    if _is_marked(vars(kind).get("pytestmark")) and hasattr(kind, "reset") and hasattr(kind, "step"):
        # pytest takes a class as the only argument for what it decorates, and the test is gone.
        words = f"the marker envcraft({kind.__name__}) marks {kind.__name__} itself, not a test"
        raise pytest.Collector.CollectError(f"{words}; write envcraft(target={kind.__name__})")
    marks = getattr(obj, "pytestmark", None) if inspect.isfunction(obj) else None
    if _is_marked(marks):
        pytest.mark.usefixtures("envcraft")(obj)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "envcraft" in metafunc.fixturenames and metafunc.definition.get_closest_marker("envcraft"):
        from envcraft.pytest_plugin.fixture import cases

        if found := cases(metafunc.definition):
            metafunc.parametrize("envcraft", found, indirect=True, ids=[case.check for case in found])


@pytest.fixture
def envcraft(request: pytest.FixtureRequest) -> EnvCraft:
    """Judge environments from within a test; with the marker `envcraft`, hold the check's report."""
    from envcraft.pytest_plugin.fixture import EnvCraft

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


def pytest_terminal_summary(terminalreporter: Any, exitstatus: int, config: pytest.Config) -> None:
    """Summarise the outcomes and the isolation of the judged environments. With xdist only the reports are known
    here.
    """
    reports = itertools.chain.from_iterable(terminalreporter.stats.values())
    counted = [one for report in reports for one in getattr(report, "envcraft_counted", ())]
    # Under -qq pytest leaves its own counts out.
    if counted and terminalreporter.verbosity >= -1:
        from envcraft.pytest_plugin.words import summary

        terminalreporter.write_line(summary(counted))
    elif exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        given = [f"--envcraft-{name.replace('_', '-')}" for name in SETTINGS if config.getoption(f"envcraft_{name}")]
        if config.getoption("envcraft"):
            words = "there is no environment here: no .py file defines a subclass of gymnasium.Env"
            collection: Any = config.pluginmanager.get_plugin("envcraft-collection")
            if excluded := collection.excluded:
                words = f"exclude in [tool.envcraft] leaves none of {excluded} environment{'s' * (excluded > 1)}"
            terminalreporter.write_line(f"envcraft: {words}")
        elif given:
            terminalreporter.write_line(f"envcraft: {given[0]} collects nothing; add --envcraft")


def _is_marked(marks: object) -> bool:
    return isinstance(marks, list) and any(mark.name == "envcraft" for mark in marks)


def _loaded(name: str) -> Any:
    """Return a module of the plugin if it is already imported."""
    return sys.modules.get(f"{__name__}.{name}")
