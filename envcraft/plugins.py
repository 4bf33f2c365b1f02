"""The plugin manager. It loads built-in plugins by name and installed ones by entry point, and isolates broken ones."""

from __future__ import annotations

import importlib
import os
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import pluggy

GROUP = "envcraft"
#: The hook specifications, by name: their types come from every layer, and this module stands below most of them.
HOOKSPECS = "envcraft.hookspecs"

#: The built-in plugins with the hooks that each implements. They are strings because the framework imports none of
#: them; a plugin is imported when one of its hooks is called.
DEFAULT_PLUGINS: dict[str, tuple[str, ...]] = {
    "envcraft.cli.commands": ("envcraft_commands",),
    "envcraft.contracts.builtin": ("envcraft_contracts",),
    "envcraft.reports.console": ("envcraft_reporters",),
    "envcraft.reports.concise": ("envcraft_reporters",),
    "envcraft.reports.json": ("envcraft_reporters",),
    "envcraft.reports.sarif": ("envcraft_reporters",),
    "envcraft.reports.junit": ("envcraft_reporters",),
    "envcraft.reports.github": ("envcraft_reporters",),
    "envcraft.reports.markdown": ("envcraft_reporters",),
    "envcraft.reports.html": ("envcraft_reporters",),
    "envcraft.corpus.export.package": ("envcraft_exporters",),
    "envcraft.corpus.export.hf": ("envcraft_exporters",),
    "envcraft.corpus.export.site": ("envcraft_exporters",),
    "envcraft_sandbox.plugin": ("envcraft_commands", "envcraft_sandbox_drivers"),
    "envcraft_checks.source": ("envcraft_checks",),
    "envcraft_checks.speed": ("envcraft_checks",),
    "envcraft_checks.api": ("envcraft_checks",),
    "envcraft_checks.determinism": ("envcraft_checks",),
    "envcraft_checks.reward": ("envcraft_checks",),
    "envcraft_checks.observation": ("envcraft_checks",),
    "envcraft_checks.termination": ("envcraft_checks",),
    "envcraft_checks.instawin": ("envcraft_checks",),
    "envcraft_checks.instadeath": ("envcraft_checks",),
    "envcraft_checks.resources": ("envcraft_checks",),
    "envcraft_checks.difficulty": ("envcraft_checks",),
    "envcraft_checks.lint": ("envcraft_checks",),
    "envcraft_checks.sandbox": ("envcraft_checks",),
    "envcraft_composer.plugin": ("envcraft_families", "envcraft_players"),
    "envcraft_dask.plugin": ("envcraft_executors",),
    "envcraft_dqn.plugin": ("envcraft_checks", "envcraft_commands", "envcraft_player_loaders"),
    "envcraft_explorer.plugin": ("envcraft_commands",),
    "envcraft_families.plugin": ("envcraft_families", "envcraft_players"),
    "envcraft_llm.plugin": (
        "envcraft_commands",
        "envcraft_exporters",
        "envcraft_generators",
        "envcraft_pools",
        "envcraft_stages",
    ),
    "envcraft_privileged.plugin": ("envcraft_commands", "envcraft_exporters", "envcraft_players"),
    "envcraft_tetris.plugin": ("envcraft_families", "envcraft_players"),
}

hookimpl = pluggy.HookimplMarker(GROUP)


@dataclass
class Broken:
    """A plugin that failed to load or to run, with its error."""

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
    """All plugins of this process, and the broken ones."""

    manager: pluggy.PluginManager
    broken: list[Broken] = field(default_factory=list)
    _distributions: dict[str, str] = field(default_factory=dict)
    _waiting: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _order: dict[str, None] = field(default_factory=dict)
    _loading: threading.RLock = field(default_factory=threading.RLock)

    def collect(self, hook: str) -> list[Any]:
        """Call one hook of every plugin and join the results.

        A plugin that raises is recorded as broken. So is a plugin whose object has the name or a code of an earlier
        object; that object is left out.
        """
        found: list[Any] = []
        taken: dict[str, str] = {}
        for plugin, names, item in self._given(hook):
            if clash := next((name for name in names if name in taken), None):
                self.note(plugin, LookupError(f"{hook}: {clash} is taken by the plugin {taken[clash]}"))
            else:
                taken.update(dict.fromkeys(names, plugin))
                found.append(item)
        return found

    def find(self, hook: str, name: str) -> Any | None:
        """Find an object of :meth:`collect` by its name, or None, without importing any later plugin."""
        return next((item for _, names, item in self._given(hook) if names[0] == name), None)

    def _given(self, hook: str) -> Iterator[tuple[str, list[str], Any]]:
        """Yield the objects of a hook in order: the plugin, the object's name and codes, the object."""
        # In pluggy's order, a plugin could put itself first.
        for plugin in list(self._order):
            # Another thread waits until the plugin is loaded. Its import may come here again in this thread.
            with self._loading:
                if hook in self._waiting.get(plugin, ()):
                    self._load(plugin)
            for implementation in getattr(self.manager.hook, hook).get_hookimpls():
                if implementation.plugin_name == plugin:
                    try:
                        for item in implementation.function():
                            yield plugin, [item.name, *(rule.code for rule in getattr(item, "rules", ()))], item
                    except Exception as error:
                        self.note(plugin, error)

    def note(self, plugin: str, error: BaseException) -> None:
        """Record that a plugin is broken."""
        self.broken.append(Broken(plugin, f"{type(error).__name__}: {error}"))

    def defer(self, module: str, hooks: tuple[str, ...]) -> None:
        """Register a built-in plugin, to be imported when one of its hooks is called."""
        self._order[module] = None
        self._waiting[module] = hooks

    def _load(self, module: str) -> None:
        del self._waiting[module]
        self.register(module, "envcraft-rl", lambda: importlib.import_module(module))

    def register(self, name: str, distribution: str, load: Any) -> None:
        """Load and register one plugin; record it as broken if it fails or implements an unknown hook."""
        self._order[name] = None
        plugin = None
        try:
            plugin = load()
            self.manager.register(plugin, name)
            # pluggy does not report an unknown hook, which is most likely misspelt.
            unknown = [hook.name for hook in self.manager.get_hookcallers(plugin) or [] if not hook.has_spec()]
            if unknown:
                raise LookupError(f"there is no hook {', '.join(unknown)}")
        except (Exception, SystemExit) as error:
            if plugin is not None and self.manager.get_plugin(name) is plugin:
                # pluggy keeps the hooks that it accepted before the error.
                self.manager.unregister(plugin)
            self.note(name, error)
        else:
            self._distributions[name] = distribution

    def list(self) -> list[Plugin]:
        """List every plugin with its distribution and hooks."""
        with self._loading:
            for module in list(self._waiting):
                self._load(module)
        listed = []
        for name in self._order:
            plugin = self.manager.get_plugin(name)
            if plugin is not None:
                hooks = [caller.name for caller in self.manager.get_hookcallers(plugin) or []]
                listed.append(Plugin(name, self._distributions.get(name, ""), sorted(hooks)))
        return listed


@cache
def plugins() -> Plugins:
    """Load the plugins of this process: built-in ones on demand, those of installed packages at once."""
    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(importlib.import_module(HOOKSPECS))
    loaded = Plugins(manager)
    for name, hooks in DEFAULT_PLUGINS.items():
        loaded.defer(name, hooks)
    for point in _entry_points():
        distribution = point.dist.name if point.dist else ""
        loaded.register(point.name, distribution, point.load)
    return loaded


def _entry_points() -> Iterator[Any]:
    """Yield the entry points of installed packages."""
    # Usually there are none, and importing importlib.metadata takes a tenth of a command's start.
    if any(_names_group(folder) for folder in sys.path):
        import importlib.metadata

        yield from importlib.metadata.entry_points(group=GROUP)


def _names_group(folder: str) -> bool:
    """Return whether a folder of ``sys.path`` may hold a package with entry points of the group; an archive may."""
    try:
        names = os.listdir(folder or ".")
    except NotADirectoryError:
        return True
    except OSError:
        return False
    for name in names:
        if name.endswith((".dist-info", ".egg-info")):
            try:
                with open(f"{folder or '.'}/{name}/entry_points.txt", "rb") as file:
                    if f"[{GROUP}]".encode() in file.read():
                        return True
            except OSError:
                continue
    return False
