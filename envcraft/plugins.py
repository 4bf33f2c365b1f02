"""The plugin manager: built-in plugins by name, installed ones by entry point, each loaded and called guarded."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pluggy

GROUP = "envcraft"

#: The built-in plugins, named as strings: the framework imports none of them.
DEFAULT_PLUGINS = (
    "envcraft.commands",
    "envcraft.contract",
    "envcraft.reports.console",
    "envcraft.reports.json",
    "envcraft.reports.sarif",
    "envcraft.reports.junit",
    "envcraft.reports.github",
    "envcraft.reports.markdown",
    "envcraft.reports.html",
    "envcraft.corpus.export.package",
    "envcraft.corpus.export.hf",
    "envcraft.corpus.export.site",
    "envcraft_sandbox.plugin",
    "envcraft_checks.source",
    "envcraft_checks.api",
    "envcraft_checks.determinism",
    "envcraft_checks.reward",
    "envcraft_checks.observation",
    "envcraft_checks.termination",
    "envcraft_checks.instawin",
    "envcraft_checks.instadeath",
    "envcraft_checks.difficulty",
    "envcraft_checks.sandbox",
    "envcraft_dask.plugin",
    "envcraft_dqn.plugin",
    "envcraft_llm.plugin",
    "envcraft_privileged.plugin",
    "envcraft_tetris.plugin",
)

hookimpl = pluggy.HookimplMarker(GROUP)


@dataclass
class Broken:
    """A plugin that could not be loaded or called, with the error that it raised."""

    plugin: str
    error: str


@dataclass
class Plugin:
    """A registered plugin, for ``envcraft plugins``."""

    name: str
    distribution: str
    hooks: list[str]


@dataclass
class Plugins:
    """All plugins of this process, and those that broke."""

    manager: pluggy.PluginManager
    broken: list[Broken] = field(default_factory=list)
    _distributions: dict[str, str] = field(default_factory=dict)

    def collect(self, hook: str) -> list[Any]:
        """Call one hook of each plugin in turn and join the lists that they give. A plugin that raises is noted, and so
        is one that gives what has the name, or a code, of what an earlier one gives; that is left out.
        """
        found: list[Any] = []
        taken: dict[str, str] = {}
        # Not in pluggy's order, which a plugin can push itself to the front of.
        order = [name for name, _ in self.manager.list_name_plugin()]
        implementations = getattr(self.manager.hook, hook).get_hookimpls()
        for implementation in sorted(implementations, key=lambda found: order.index(found.plugin_name)):
            plugin = implementation.plugin_name
            try:
                for item in implementation.function():
                    names = [item.name, *(rule.code for rule in getattr(item, "rules", ()))]
                    if clash := next((name for name in names if name in taken), None):
                        self.note(plugin, LookupError(f"{hook}: {clash} is taken by the plugin {taken[clash]}"))
                    else:
                        taken.update(dict.fromkeys(names, plugin))
                        found.append(item)
            except Exception as error:
                self.note(plugin, error)
        return found

    def note(self, plugin: str, error: BaseException) -> None:
        """Remember that a plugin broke."""
        self.broken.append(Broken(plugin, f"{type(error).__name__}: {error}"))

    def register(self, name: str, distribution: str, load: Any) -> None:
        """Load and register one plugin; a failure, or a hook that no specification knows, is noted."""
        plugin = None
        try:
            plugin = load()
            self.manager.register(plugin, name)
            # pluggy keeps quiet about a hook that no specification knows: most likely it is misspelt.
            unknown = [hook.name for hook in self.manager.get_hookcallers(plugin) or [] if not hook.has_spec()]
            if unknown:
                raise LookupError(f"no hook is called {', '.join(unknown)}")
        except (Exception, SystemExit) as error:
            if plugin is not None and self.manager.get_plugin(name) is plugin:
                # pluggy keeps the hooks that came before the one that it refused.
                self.manager.unregister(plugin)
            self.note(name, error)
        else:
            self._distributions[name] = distribution

    def list(self) -> list[Plugin]:
        """Every registered plugin with its distribution and the hooks that it fills."""
        listed = []
        for name, plugin in self.manager.list_name_plugin():
            if plugin is not None:
                hooks = [caller.name for caller in self.manager.get_hookcallers(plugin) or []]
                listed.append(Plugin(name, self._distributions.get(name, ""), sorted(hooks)))
        return listed


@cache
def plugins() -> Plugins:
    """Load the built-in plugins, then those of installed packages."""
    from envcraft import hookspecs

    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(hookspecs)
    loaded = Plugins(manager)
    for name in DEFAULT_PLUGINS:
        loaded.register(name, "envcraft-rl", lambda name=name: importlib.import_module(name))
    for point in _entry_points():
        distribution = point.dist.name if point.dist else ""
        loaded.register(point.name, distribution, point.load)
    return loaded


def _entry_points() -> Iterator[Any]:
    """The entry points of installed packages."""
    # Mostly there are none, and the module that reads them takes a tenth of a command's whole start to import.
    if any(_names_group(folder) for folder in sys.path):
        import importlib.metadata

        yield from importlib.metadata.entry_points(group=GROUP)


def _names_group(folder: str) -> bool:
    """Whether packages in a folder of ``sys.path`` may have entry points of the group; an archive may."""
    try:
        names = os.listdir(folder or ".")
    except NotADirectoryError:
        return True
    except OSError:
        return False
    for name in names:
        if name.endswith((".dist-info", ".egg-info")):
            try:
                if f"[{GROUP}]" in Path(folder, name, "entry_points.txt").read_text("utf-8"):
                    return True
            except (OSError, UnicodeDecodeError):
                continue
    return False
