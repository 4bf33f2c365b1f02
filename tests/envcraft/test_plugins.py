"""One broken plugin is named, and the others go on."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import click
import pluggy
import pytest

from envcraft import hookspecs
from envcraft.errors import SandboxUnavailable
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.judging.selection import all_checks, driver_named
from envcraft.plugins import DEFAULT_PLUGINS, GROUP, Plugins, hookimpl, plugins


@pytest.fixture
def empty() -> Plugins:
    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(hookspecs)
    return Plugins(manager)


def plugin(name: str, hook: str, function: Callable[[], Any]) -> Callable[[], types.ModuleType]:
    """A loader of a module with one hook."""
    module = types.ModuleType(name)
    function.__name__ = hook
    setattr(module, hook, hookimpl(function))
    return lambda: module


def raises() -> Any:
    raise RuntimeError("no luck")


RULE = types.SimpleNamespace(name="a check", rules=[types.SimpleNamespace(code="XX001")])


def gives() -> Any:
    return [RULE]


def test_built_in_plugins_all_load() -> None:
    assert not [broken for broken in plugins().broken if broken.plugin in DEFAULT_PLUGINS]
    assert {listed.name for listed in plugins().list()} >= set(DEFAULT_PLUGINS)


def test_built_in_plugins_fill_the_hooks_that_they_are_known_for() -> None:
    filled = {listed.name: tuple(listed.hooks) for listed in plugins().list() if listed.name in DEFAULT_PLUGINS}
    assert filled == DEFAULT_PLUGINS


def test_a_built_in_plugin_is_imported_when_its_hook_is_asked_and_keeps_its_place(
    empty: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = types.SimpleNamespace(name="other", rules=[])
    built_in = {
        "one": plugin("one", "envcraft_checks", gives),
        "two": plugin("two", "envcraft_contracts", raises),
        "three": plugin("three", "envcraft_checks", lambda: [other]),
    }
    for (name, load), hook in zip(
        built_in.items(), ["envcraft_checks", "envcraft_contracts", "envcraft_checks"], strict=True
    ):
        empty.defer(name, (hook,))
        monkeypatch.setitem(sys.modules, name, load())
    empty.register("foreign", "foreign-dist", plugin("foreign", "envcraft_checks", lambda: [RULE]))
    assert empty.find("envcraft_checks", "a check") is RULE
    assert [name for name, _ in empty.manager.list_name_plugin()] == ["foreign", "one"]
    assert empty.collect("envcraft_checks") == [RULE, other]
    (broken,) = empty.broken
    assert broken.plugin == "foreign"
    assert empty.find("envcraft_checks", "none") is None
    assert [listed.name for listed in empty.list()] == ["one", "two", "three", "foreign"]


def test_a_thread_waits_for_a_plugin_that_another_one_loads(empty: Plugins, monkeypatch: pytest.MonkeyPatch) -> None:
    importing = threading.Event()

    def load(name: str) -> Any:
        importing.set()
        time.sleep(0.2)
        return plugin("slow", "envcraft_checks", gives)()

    monkeypatch.setattr("envcraft.plugins.importlib.import_module", load)
    empty.defer("slow", ("envcraft_checks",))
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(empty.collect, "envcraft_checks")
        assert importing.wait(10)
        second = threads.submit(empty.collect, "envcraft_checks")
        assert (first.result(), second.result()) == ([RULE], [RULE])


def test_a_hook_that_raises_is_named_and_the_rest_go_on(empty: Plugins) -> None:
    empty.register("bad", "bad-dist", plugin("bad", "envcraft_checks", raises))
    empty.register("good", "good-dist", plugin("good", "envcraft_checks", gives))
    assert empty.collect("envcraft_checks") == [RULE]
    assert [(broken.plugin, broken.error) for broken in empty.broken] == [("bad", "RuntimeError: no luck")]


def test_a_plugin_that_cannot_be_imported_is_named(empty: Plugins) -> None:
    def load() -> Any:
        raise ImportError("no module named torch")

    empty.register("heavy", "heavy-dist", load)
    assert empty.list() == []
    assert "no module named torch" in empty.broken[0].error


def test_a_misspelt_hook_is_reported(empty: Plugins) -> None:
    empty.register("typo", "typo-dist", plugin("typo", "envcraft_cheks", gives))
    assert "envcraft_cheks" in empty.broken[0].error
    assert empty.list() == []


def test_hook_with_unknown_argument_unloads_the_plugin(empty: Plugins) -> None:
    module = plugin("half", "envcraft_checks", gives)()

    def envcraft_reporters(config: Any) -> Any: ...

    module.envcraft_reporters = hookimpl(envcraft_reporters)  # type: ignore[attr-defined]
    empty.register("half", "half-dist", lambda: module)
    assert "config" in empty.broken[0].error
    assert empty.list() == []
    assert empty.collect("envcraft_checks") == []


def test_a_plugin_that_exits_when_it_is_imported_is_named(empty: Plugins) -> None:
    empty.register("quits", "quits-dist", lambda: sys.exit(7))
    assert empty.broken[0].error == "SystemExit: 7"


@pytest.mark.parametrize(
    ("name", "codes"), [("a check", ["YY001"]), ("another", ["YY001", "XX001"])], ids=["name", "code"]
)
def test_the_first_to_give_a_name_or_a_code_keeps_it(empty: Plugins, name: str, codes: list[str]) -> None:
    clashing = types.SimpleNamespace(name=name, rules=[types.SimpleNamespace(code=code) for code in codes])
    other = types.SimpleNamespace(name="other", rules=[])
    empty.register("first", "first-dist", plugin("first", "envcraft_checks", gives))
    empty.register("second", "second-dist", plugin("second", "envcraft_checks", lambda: [clashing, other]))
    assert empty.collect("envcraft_checks") == [RULE, other]
    (broken,) = empty.broken
    assert broken.plugin == "second"
    assert broken.error.endswith("is taken by the plugin first")


def test_no_plugin_can_push_itself_to_the_front(empty: Plugins) -> None:
    late = hookimpl(trylast=True)(lambda: [types.SimpleNamespace(name="a check", rules=[])])
    empty.register("first", "first-dist", plugin("first", "envcraft_checks", gives))
    empty.register("second", "second-dist", types.SimpleNamespace(envcraft_checks=late))
    assert empty.collect("envcraft_checks") == [RULE]
    assert [broken.plugin for broken in empty.broken] == ["second"]


def test_a_second_plugin_of_a_name_changes_nothing_of_the_first(empty: Plugins) -> None:
    empty.register("twin", "one", plugin("one", "envcraft_checks", gives))
    empty.register("twin", "two", plugin("two", "envcraft_contracts", gives))
    (listed,) = empty.list()
    assert (listed.distribution, listed.hooks) == ("one", ["envcraft_checks"])
    assert empty.collect("envcraft_checks") == [RULE]


def test_hook_that_returns_unnamed_values_is_reported(empty: Plugins) -> None:
    empty.register("odd", "odd-dist", plugin("odd", "envcraft_checks", lambda: ["a check"]))
    assert empty.collect("envcraft_checks") == []
    assert "name" in empty.broken[0].error


def test_checks_that_always_run_come_last(empty: Plugins, monkeypatch: pytest.MonkeyPatch) -> None:
    last = types.SimpleNamespace(name="last", rules=[], always=True, gate=False)
    own = types.SimpleNamespace(name="own", rules=[], always=False, gate=False)
    empty.register("built-in", "envcraft-rl", plugin("built-in", "envcraft_checks", lambda: [last]))
    empty.register("foreign", "foreign-dist", plugin("foreign", "envcraft_checks", lambda: [own]))
    monkeypatch.setattr("envcraft.registry.plugins", lambda: empty)
    assert [check.name for check in all_checks()] == ["own", "last"]


class Works(Driver):
    name, isolation, rank = "works", Isolation.NAMESPACE, 1

    def probe(self) -> Availability:
        return Availability(True)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        raise NotImplementedError


class Breaks(Works):
    name, rank = "breaks", 99

    def probe(self) -> Availability:
        raise RuntimeError("no luck")

    def sweep(self) -> None:
        raise RuntimeError("no luck")


def test_a_driver_that_breaks_leaves_the_others(empty: Plugins, monkeypatch: pytest.MonkeyPatch) -> None:
    empty.register("drivers", "dist", plugin("drivers", "envcraft_sandbox_drivers", lambda: [Breaks(), Works()]))
    monkeypatch.setattr("envcraft.registry.plugins", lambda: empty)
    assert driver_named("auto").name == "works"
    with pytest.raises(SandboxUnavailable, match="no luck"):
        driver_named("breaks")


def test_listing_names_distribution_and_hooks(empty: Plugins) -> None:
    empty.register("good", "good-dist", plugin("good", "envcraft_checks", gives))
    (listed,) = empty.list()
    assert (listed.name, listed.distribution, listed.hooks) == ("good", "good-dist", ["envcraft_checks"])


def test_the_command_line_warns_in_one_line_and_works(
    empty: Plugins, invoke: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty.register("bad", "bad-dist", plugin("bad", "envcraft_commands", raises))
    empty.register("good", "good-dist", plugin("good", "envcraft_commands", lambda: [click.Command("hello")]))
    monkeypatch.setattr("envcraft.registry.plugins", lambda: empty)
    result = invoke("--help")
    assert result.exit_code == 0
    assert "hello" in result.stdout
    warnings = [line for line in result.stderr.splitlines() if line]
    assert len(warnings) == 1
    assert "bad" in warnings[0]
    assert "no luck" in warnings[0]


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder with one installed package that has a plugin."""
    (tmp_path / "third_party.py").write_text(
        "from envcraft.contracts.builtin import ARCADE\nfrom envcraft.plugins import hookimpl\nimport msgspec\n\n"
        "@hookimpl\ndef envcraft_contracts():\n    return [msgspec.structs.replace(ARCADE, name='third-party')]\n"
    )
    about = tmp_path / "third_party-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: third-party\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[envcraft]\nthird = third_party\n")
    return tmp_path


def listed_from(path: Path) -> str:
    """What ``envcraft contracts`` lists when `path` is on Python's path."""
    folders = [str(path), *filter(None, sys.path)]
    done = subprocess.run(
        [sys.executable, "-m", "envcraft", "contracts"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(folders)},
        capture_output=True,
        check=True,
        text=True,
    )
    assert "Warning" not in done.stderr
    return done.stdout


def test_an_installed_package_brings_its_plugin(package: Path) -> None:
    assert "third-party" in listed_from(package)


def test_a_package_in_an_archive_brings_its_plugin(package: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    archive = shutil.make_archive(str(tmp_path_factory.mktemp("archive") / "packages"), "zip", package)
    assert "third-party" in listed_from(Path(archive))


def test_other_packages_bring_none(package: Path) -> None:
    (package / "third_party-1.0.dist-info" / "entry_points.txt").write_text("[console_scripts]\nx = y:z\n")
    assert "third-party" not in listed_from(package)
