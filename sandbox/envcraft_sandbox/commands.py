"""The commands ``envcraft doctor`` and ``envcraft sandbox build``."""

from __future__ import annotations

import json
import platform
import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import click

from envcraft.cli import completion
from envcraft.cli.options import runtime_option

if TYPE_CHECKING:
    from envcraft.judging.driver import Driver

#: The fix for a missing layer, by the beginning of its name.
_REMEDIES = {
    "engine's seccomp profile": "let the engine use its default seccomp profile (`seccomp-profile` in daemon.json)",
    "memory limit": "enable the memory cgroup (kernel parameter cgroup_enable=memory)",
    "swap limit": "enable swap accounting (kernel parameter swapaccount=1)",
    "process limit": "enable the pids cgroup (a kernel with CONFIG_CGROUP_PIDS)",
    "one CPU": "enable CPU quotas (a kernel with CONFIG_CFS_BANDWIDTH)",
    "Landlock": "use Linux 5.13 or later, with landlock among its security modules (kernel parameter lsm)",
    "system call filter": "use a kernel with CONFIG_SECCOMP_FILTER",
    "watchdog": "mount /proc where the worker can read it",
}
#: The least width of a terminal for a table, in columns.
_TABLE = 72


@click.command()
@click.option("--format", "form", type=click.Choice(["console", "json"]), default="console", show_default=True)
@runtime_option
def doctor(form: str, runtime: str | None) -> None:
    """Check which sandboxes work here, and how to fix the others.

    The command starts a worker in each sandbox. It lists the active layers, the missing layers, and how to add each.

    \b
    Exit status: 0 a sandbox works    3 none works
    """
    from envcraft.judging.selection import under
    from envcraft.plugins import plugins

    loaded = plugins()
    drivers = sorted(loaded.collect("envcraft_sandbox_drivers"), key=lambda driver: -driver.rank)
    if runtime is not None:
        drivers = under(runtime, drivers)
    results: list[Examined] = []
    for driver in drivers:
        try:
            driver.sweep()
            results.append(examine(driver))
        except Exception as error:
            loaded.note(f"sandbox {driver.name}", error)
    auto = next((each.name for each in results if each.works), None)
    broken = [{"plugin": each.plugin, "error": each.error} for each in loaded.broken]
    if form == "json":
        report = {
            "platform": _platform(),
            "sandboxes": [asdict(each) for each in results],
            "auto": auto,
            "broken": broken,
        }
        click.echo(json.dumps(report, indent=2))
    else:
        _show(results, auto, broken, runtime)
    if auto is None:
        raise SystemExit(3)


@dataclass(frozen=True)
class Examined:
    """How well a driver works on this machine. `fix` is the next step if it fails or if layers are missing."""

    name: str
    isolation: str
    works: bool
    layers: list[str]
    missing: list[str]
    reason: str
    fix: str
    image: str | None = None


def examine(driver: Driver) -> Examined:
    """Launch a worker: the layers that it observes inside count more than those that the machine promises."""
    from envcraft.errors import EnvCraftError
    from envcraft.judging.driver import Limits
    from envcraft.model.verdict import SandboxReport

    available = driver.probe()
    reason, fix = available.reason, available.fix
    report = SandboxReport()
    if available.works:
        try:
            worker = driver.launch(hash_seed=0, limits=Limits())
        except EnvCraftError as error:
            reason, _, fix = str(error).partition("; ")
        else:
            try:
                report = SandboxReport.of(driver.name, available.layers, available.missing, worker.about)
            finally:
                worker.close()
            fix = "; ".join(filter(None, map(_remedy, report.missing)))
    return Examined(
        driver.name, driver.isolation.value, not reason, report.layers, report.missing, reason, fix, report.image
    )


def _remedy(layer: str) -> str:
    return next((words for name, words in _REMEDIES.items() if layer.startswith(name)), "")


@click.group()
def sandbox() -> None:
    """Manage the sandboxes."""


@sandbox.command()
@click.option(
    "--base",
    metavar="IMAGE",
    help="Base image with Python 3.11 or later and pip. `host` copies the running interpreter and needs no registry.  "
    "[default: python:3.11-slim]",
)
@click.option(
    "--packages",
    metavar="FILE",
    shell_complete=completion.files,
    help="File of additional libraries, one NAME or NAME==VERSION per line. The image always has NumPy, Gymnasium, "
    "pygame-ce and SciPy.",
)
def build(base: str | None, packages: str | None) -> None:
    """Build the image of the docker sandbox."""
    from . import build as image
    from .packages import read

    wanted = read(packages) if packages is not None else []
    tag, digest = image.build(base or image.DEFAULT_BASE, lambda words: click.echo(words, err=True), wanted)
    click.echo(f"{tag} {digest}")


def _platform() -> dict[str, str]:
    return {"system": platform.system(), "release": platform.release(), "python": platform.python_version()}


def _show(results: list[Examined], auto: str | None, broken: list[dict[str, str]], runtime: str | None) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.padding import Padding
    from rich.table import Column, Table
    from rich.text import Text

    # Highlighting would set numbers in the middle of a version in bold, also with NO_COLOR.
    console = Console(highlight=False)
    table = Table(
        "sandbox", "isolation", "works", Column("active layers, missing layers, and the fix", overflow="fold")
    )
    narrow = console.width < _TABLE
    console.print("Python {python} on {system} {release}".format(**_platform()))
    for each in results:
        lines = ["; ".join(each.layers)] if each.works else [f"{each.reason}: {each.fix}"]
        if each.missing:
            lines.append(f"missing: {'; '.join(each.missing)}" + (f". {each.fix}" if each.fix else ""))
        works = "[green]yes[/]" if each.works else "[red]no[/]"
        if narrow:
            console.print(f"{escape(each.name)} ({each.isolation}), works: {works}")
            console.print(Padding(Text("\n".join(lines), overflow="fold"), (0, 0, 0, 2)))
        else:
            table.add_row(escape(each.name), each.isolation, works, escape("\n".join(lines)))
    if not narrow:
        console.print(table)
    if sys.platform != "linux":
        console.print(
            "Landlock, seccomp and namespaces exist only on Linux. Here a sandbox protects against accidents, not "
            "against malice: run generated code in a Linux container or virtual machine."
        )
    if auto is None and runtime is not None:
        console.print(f"No sandbox works with --runtime {escape(runtime)}; `envcraft doctor` checks all sandboxes.")
    elif auto is None:
        console.print("No sandbox works on this machine, so EnvCraft cannot validate anything.")
    else:
        console.print(f"`--sandbox auto` takes {auto}.")
    for each_broken in broken:
        console.print(f"[red]broken plugin[/] {escape(each_broken['plugin'])}: {escape(each_broken['error'])}")
