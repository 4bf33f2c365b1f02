"""What a shell offers after Tab: contracts, checks, codes, families, formats, sandboxes and files.

Click writes the shell's part: ``eval "$(_ENVCRAFT_COMPLETE=bash_source envcraft)"``. Each function here is the
``shell_complete`` of a parameter and returns what fits the incomplete word.
"""

from __future__ import annotations

import glob
from collections.abc import Iterable

import click
from click.shell_completion import CompletionItem

from envcraft.contracts.lookup import all_contracts
from envcraft.judging.selection import all_checks
from envcraft.registry import offered


def contracts(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the names of contracts."""
    return _starting([(contract.name, "") for contract in all_contracts()], incomplete)


def checks(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the names of checks, for a list that commas separate."""
    return _next_of([(check.name, "") for check in all_checks()], incomplete)


def codes(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the codes of rules, for a list that commas separate."""
    return _next_of([(rule.code, rule.name) for check in all_checks() for rule in check.rules], incomplete)


def codes_and_checks(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer one code or check."""
    names = [(rule.code, rule.name) for check in all_checks() for rule in check.rules]
    return _starting([*names, *((check.name, "") for check in all_checks())], incomplete)


def formats(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the formats of reports."""
    return _starting([(kind.name, kind.summary) for kind in offered("envcraft_reporters")], incomplete)


def reports(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer FORMAT:FILE with a usual name of the file, or the files that a name begins."""
    form, colon, path = incomplete.partition(":")
    if colon:
        return [CompletionItem(f"{form}:{found}") for found in sorted(glob.glob(f"{glob.escape(path)}*"))]
    kinds = offered("envcraft_reporters")
    return _starting([(f"{kind.name}:report{kind.suffix or '.txt'}", kind.summary) for kind in kinds], incomplete)


def folders_and_reports(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer FORMAT:FILE, and leave the names of folders to the shell."""
    return [*folders(ctx, param, incomplete), *reports(ctx, param, incomplete)]


def exports(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the formats of exports."""
    return _starting([(exporter.name, exporter.summary) for exporter in offered("envcraft_exporters")], incomplete)


def families(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the families of environments, for a list that commas separate."""
    return _next_of([(family.name, "") for family in offered("envcraft_families")], incomplete)


def sandboxes(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Offer the names of sandboxes."""
    drivers = [(driver.name, "") for driver in offered("envcraft_sandbox_drivers")]
    return _starting([("auto", ""), *drivers], incomplete)


def files(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Leave the names of files and folders to the shell."""
    return [CompletionItem(incomplete, type="file")]


def folders(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Leave the names of folders to the shell."""
    return [CompletionItem(incomplete, type="dir")]


def _starting(names: Iterable[tuple[str, str]], incomplete: str, before: str = "") -> list[CompletionItem]:
    return [
        CompletionItem(before + name, help=words)
        for name, words in names
        if name.lower().startswith(incomplete.lower())
    ]


def _next_of(names: Iterable[tuple[str, str]], incomplete: str) -> list[CompletionItem]:
    """Complete the last name of a list, and leave out those that it has."""
    before, comma, last = incomplete.rpartition(",")
    taken = before.split(",")
    return _starting([(name, words) for name, words in names if name not in taken], last, before + comma)
