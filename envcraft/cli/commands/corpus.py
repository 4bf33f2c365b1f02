"""The commands of ``envcraft corpus`` that change, show and check a corpus."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import msgspec

from envcraft.cli import completion
from envcraft.cli.commands.duplicates import dedup, diversity, split
from envcraft.cli.commands.outputs import output_file
from envcraft.cli.commands.report import report
from envcraft.corpus.store import (
    DATABASE,
    SOURCES,
    CorpusDamaged,
    Store,
    decode,
    environments,
    find,
    is_corpus,
    verdicts,
)
from envcraft.corpus.store.environments import Listed
from envcraft.environments.targets import environments_below
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.generation.history import history_data, history_lines
from envcraft.judging.selection import all_checks
from envcraft.model.project import with_project
from envcraft.model.target import MAX_SOURCE, Target, read_target
from envcraft.model.verdict import Outcome, plain
from envcraft.registry import did_you_mean
from envcraft.text import one_line, plural, printable

_FORMAT = click.option("--format", "form", type=click.Choice(["table", "json"]), default="table", show_default=True)
_CORPUS = click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))


@click.command(short_help="Create an empty corpus.")
@_CORPUS
def init(corpus: Path) -> None:
    """Create an empty corpus in a new folder."""
    Store.create(corpus).close()
    click.echo(f"created the corpus {corpus}; `envcraft corpus add {corpus} FOLDER` adds environments")


@click.command(short_help="Add files or folders.")
@_CORPUS
@click.argument("paths", metavar="FILE|FOLDER...", shell_complete=completion.files, nargs=-1, required=True)
@click.option("--class", "env_class", metavar="NAME", default="", help="The class to judge, if a file has several.")
@click.option(
    "--metadata", metavar="JSON", help="A JSON object to store with each environment, such as its model or licence."
)
@click.option("--replace", is_flag=True, help="Replace environments that have the same names.")
@click.pass_context
def add(
    ctx: click.Context, corpus: Path, paths: tuple[str, ...], env_class: str, metadata: str | None, replace: bool
) -> None:
    """Add environments from files or folders.

    A file is added under its name, a file below a folder under its path in the folder. A source that the corpus already
    has is reported and skipped.
    """
    fields = _metadata(metadata)
    for path in paths:
        # Its sources are named by digests, and its verdicts and origins are not in them.
        if is_corpus(Path(path)):
            raise UsageError(f"{path} is a corpus; `envcraft corpus merge {corpus} {path}` adds its environments")
    added, known, refused, parts = 0, 0, 0, 0

    def refuse(words: str) -> None:
        nonlocal refused
        refused += 1
        click.echo(f"Error: {one_line(words)}", err=True)

    with Store(corpus, write=True) as store:
        if store.follows_folder:
            raise UsageError(f"{corpus} follows a folder: put files there, and `envcraft audit` adds them")
        for name, target in _files(paths, refuse):
            row = environments.get(store, name)
            found = row and row.environment
            twins = [twin for twin in store.twins(target.source, env_class) if twin != name]
            if len(target.source) > MAX_SOURCE:
                refuse(f"{target.path} is larger than {MAX_SOURCE:,} bytes")
            elif twins and (found is None or not replace):
                click.echo(
                    f"{one_line(target.path)} has the same source as {one_line(twins[0])} and is skipped", err=True
                )
                known += 1
            elif found not in (None, (name, target.sha256, env_class)) and not replace:
                other = "source" if found and found.source != target.sha256 else "class of this source"
                refuse(f"{name} has another {other} in {corpus}; --replace replaces it by {target.path}")
            else:
                origin = {"file": target.path, **fields}
                fresh = _put(store, name, target, env_class, origin)
                if not fresh and replace:
                    store.describe(name, origin)
                added, known = added + fresh, known + (not fresh)
                parts += target.project is not None
        store.prune()
    if parts:
        words = "needs other files of its project, which" if parts == 1 else "need other files of their projects, which"
        click.echo(f"{parts:,} of them {words} a corpus does not hold; `envcraft audit FOLDER` does", err=True)
    click.echo(f"{plural(added, 'environment')} added, {known:,} already present")
    ctx.exit(ExitCode.USAGE if refused else ExitCode.PASS)


@click.command(name="list", short_help="List environments and verdicts.")
@_CORPUS
@click.option(
    "--verdict",
    type=click.Choice([*(o.value for o in Outcome if o is not Outcome.SKIP), "none"]),
    help="List only environments with this verdict. `undecided` lists the passes with an undecided "
    "check, `pass` the others, and `none` the environments without a verdict.",
)
@click.option(
    "--code",
    metavar="CODE",
    shell_complete=completion.codes,
    help="List only environments with a finding of this code, such as EC203.",
)
@click.option("--name", metavar="GLOB", help="List only environments whose names match a pattern, such as 'games/*'.")
@_FORMAT
def list_(corpus: Path, verdict: str | None, code: str | None, name: str | None, form: str) -> None:
    """List environments with the last verdict on each.

    The verdict is "none" if there is no verdict on the present source.
    """
    with Store(corpus) as store:
        if code is not None:
            _known(store, code)
        rows = environments.listed(store, verdict, code and code.upper(), name and plain(name))
        if form == "json":
            _write_array(_row(row) for row in rows)
            return
        for row in rows:
            outcome = Outcome.UNDECIDED if row.undecided else row.verdict or "none"
            click.echo(f"{outcome:9}  {one_line(row.environment.name)}  {' '.join(row.codes)}".rstrip())


def _known(store: Store, code: str) -> None:
    """Check that a rule or a finding of the corpus has a code. Raises UsageError."""
    rules = {rule.code for check in all_checks() for rule in check.rules}
    found = verdicts.codes(store)
    if code.upper() not in rules | found:
        raise UsageError(f"there is no rule {did_you_mean(code, sorted(rules | found))}")


@click.command(short_help="Show one environment.")
@_CORPUS
@click.argument("name")
@click.option("--source", is_flag=True, help="Write the source instead.")
@_FORMAT
def show(corpus: Path, name: str, source: bool, form: str) -> None:
    """Show an environment, all verdicts on its source, and how it was generated."""
    with Store(corpus) as store:
        row = environments.listing(store, plain(name)) or environments.listing(store, plain(f"{name}.py"))
        if row is None:
            raise UsageError(f"{corpus} has no environment {name}; `envcraft corpus list {corpus}` lists them")
        if source:
            sys.stdout.flush()
            sys.stdout.buffer.write(store.source(row.environment.source))
            return
        history = history_data(store, str(row.origin.get("concept", "")))
        found = [
            (settings, decode(text))
            for settings, text in verdicts.of_source(store, row.environment.source, row.environment.env_class)
        ]
    keys = ("contract", "budget", "seed", "driver", "rules", "image")
    summary = {**_row(row), "origin": row.origin}
    if form == "json":
        summary["verdicts"] = [
            {**{key: getattr(settings, key) for key in keys}, "report": one} for settings, one in found
        ]
        if history:
            summary["history"] = history
        click.echo(msgspec.json.format(msgspec.json.encode(plain(summary)), indent=2))
        return
    judged = next((one.env_class for _, one in reversed(found)), None) or "-"
    for key in ("name", "source", "class", "added", "origin"):
        value = json.dumps(summary[key]) if key == "origin" else summary[key] or judged
        click.echo(f"{key:7}  {one_line(value)}".rstrip())
    for settings, judged_report in found:
        words = ", ".join(f"{key} {getattr(settings, key)}" for key in keys[:5])
        click.echo(f"\n{judged_report.outcome.value}  {words}")
        for check in judged_report.checks:
            if check.outcome in (Outcome.UNDECIDED, Outcome.ERROR):
                words = "undecided" if check.outcome is Outcome.UNDECIDED else "could not be judged"
                click.echo(f"  {one_line(check.check)} {words}: {one_line(check.reason)}")
            for finding in check.findings:
                place = f" {judged_report.file}:{finding.line}" if finding.line else ""
                words = f"{finding.code} {finding.severity.value}{place}: {finding.message}"
                click.echo(f"  {one_line(words)}")
    for line in history_lines(history) if history else ():
        click.echo(printable(line.replace("\n", " ")))


@click.command(short_help="Remove environments.")
@_CORPUS
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@click.pass_context
def rm(ctx: click.Context, corpus: Path, names: tuple[str, ...]) -> None:
    """Remove environments from a corpus.

    Their verdicts are removed unless another environment has the same source.
    """
    unknown = 0
    with Store(corpus, write=True) as store:
        if store.follows_folder:
            raise UsageError(f"{corpus} follows a folder: remove files there, and `envcraft audit` removes them")
        for name in names:
            if not (store.remove(plain(name)) or store.remove(plain(f"{name}.py"))):
                words = f"{corpus} has no environment {name}; `envcraft corpus list {corpus}` lists them"
                click.echo(f"Error: {words}", err=True)
                unknown += 1
    click.echo(f"{plural(len(names) - unknown, 'environment')} removed")
    ctx.exit(ExitCode.USAGE if unknown else ExitCode.PASS)


@click.command(short_help="Check and repair a corpus.")
@_CORPUS
@click.option("--repair", is_flag=True, help="Repair what can be repaired, and move the rest to CORPUS/lost+found.")
@click.pass_context
def verify(ctx: click.Context, corpus: Path, repair: bool) -> None:
    """Check the digests, references and verdicts of a corpus.

    \b
    Exit status: 0 no damage, or all repaired
                 1 damage
                 2 usage error
                 3 the corpus cannot be read
    """
    from envcraft.corpus.verify import verify as check
    from envcraft.demonstrations.store import verify as verify_recordings

    left = found = 0
    try:
        with Store(corpus, write=True) as store:
            for damage in check(store, repair, {"the next `envcraft demos` records it again": verify_recordings}):
                found += 1
                left += not damage.done
                click.echo(one_line(f"{damage.what}: {damage.done}" if damage.done else damage.what))
            count = environments.count(store)
    except OSError as error:
        raise EnvCraftError(f"{error.filename or corpus} cannot be read or repaired: {error.strerror}") from None
    except CorpusDamaged as error:
        raise CorpusDamaged(f"{error.what}: {_restore_hint(find(corpus))}") from error
    if not found:
        click.echo(f"{plural(count, 'environment')}: no damage")
    elif left and not repair:
        click.echo(f"{left:,} damaged; --repair repairs what can be repaired", err=True)
    elif left:
        click.echo(
            f"{left:,} cannot be repaired: {_restore_hint(find(corpus))}",
            err=True,
        )
    ctx.exit(ExitCode.FAIL if left else ExitCode.PASS)


@click.command(short_help="Add another corpus to this one.")
@_CORPUS
@click.argument("other", metavar="OTHER", type=click.Path(path_type=Path))
def merge(corpus: Path, other: Path) -> None:
    """Add the content of another corpus: environments, verdicts, generation history and model answers."""
    from envcraft.corpus.merge import merge as take
    from envcraft.registry import offered

    with Store(corpus, write=True) as store, Store(other) as source:
        if store.follows_folder:
            raise UsageError(f"{corpus} follows a folder; merge into a corpus that `envcraft corpus init` made")
        try:
            merged = take(store, source)
            generators = [generator for generator in offered("envcraft_generators") if generator.merge is not None]
            beside = [generator.merge(store.root, source.root) for generator in generators]
        except OSError as error:
            raise EnvCraftError(f"{corpus} cannot be written to: {error.strerror}") from None
    for old, new in merged.renamed:
        click.echo(
            f"{one_line(old)} has another source in {corpus}; that of {other} is added as {one_line(new)}", err=True
        )
    found = [plural(merged.added, "environment"), plural(merged.verdicts, "verdict")]
    found += [plural(merged.concepts, "concept")] if merged.concepts else []
    found += filter(None, beside)
    click.echo(f"{', '.join(found[:-1])} and {found[-1]} added")


@click.command(short_help="Write validation records.")
@_CORPUS
@click.option("--output", type=click.Path(dir_okay=False), default="-", metavar="FILE", help="The file to write.")
def records(corpus: Path, output: str) -> None:
    """Write a validation record for each judged environment.

    A record is a line of JSON. `envcraft reverify` judges the environments again and compares.
    """
    from envcraft.corpus.records import records_of

    count = 0
    with Store(corpus) as store, click.open_file("-", "wb") if output == "-" else output_file(output) as stream:
        for record in records_of(store):
            stream.write(msgspec.json.encode(record) + b"\n")
            count += 1
    click.echo(f"{plural(count, 'record')} written", err=True)


COMMANDS = (init, add, list_, show, rm, verify, merge, records, dedup, diversity, split, report)


def _files(paths: tuple[str, ...], refuse: Callable[[str], None]) -> Iterator[tuple[str, Target]]:
    """Yield the name and the target of each file at or below the paths; `refuse` receives the errors of the others."""
    for path in paths:
        found = False
        try:
            if os.path.isdir(path):
                for target in environments_below(path, unreadable=lambda _, error: refuse(str(error))):
                    found = True
                    yield plain(os.path.relpath(target.path, path)), target
                if not found:
                    refuse(f"{path} holds no environment: no .py file in it defines a subclass of gymnasium.Env")
            else:
                target = with_project(read_target(path))
                yield plain(os.path.basename(path)), target
        except UsageError as error:
            refuse(str(error))


def _restore_hint(root: Path) -> str:
    """What to do if a database is lost."""
    return (
        f"restore {root / DATABASE} from a copy, or make a new corpus from the sources with `envcraft corpus init NEW` "
        f"and `envcraft corpus add NEW {root / SOURCES}`"
    )


def _put(store: Store, name: str, target: Target, env_class: str, origin: dict[str, Any]) -> bool:
    try:
        return store.add(name, target.source, env_class, origin)
    except OSError as error:
        raise EnvCraftError(f"{target.path} cannot be copied to {store.root}: {error.strerror}") from None


def _metadata(text: str | None) -> dict[str, Any]:
    try:
        value = json.loads(text or "{}")
    except (ValueError, RecursionError) as error:
        raise UsageError(f"--metadata {text} is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise UsageError(f'--metadata {text} is not a JSON object; write it like \'{{"model": "a"}}\'')
    return value


def _row(row: Listed) -> dict[str, Any]:
    return {
        "name": row.environment.name,
        "source": row.environment.source,
        "class": row.environment.env_class or None,
        "added": row.added,
        "verdict": row.verdict,
        "undecided": row.undecided,
        "steps": row.steps,
        "seconds": row.seconds,
        "codes": row.codes,
    }


def _write_array(rows: Iterator[dict[str, Any]]) -> None:
    """Write a JSON array, one row a line, without keeping the rows in memory."""
    sys.stdout.write("[")
    for number, row in enumerate(rows):
        sys.stdout.write(f"{',' if number else ''}\n{msgspec.json.encode(row).decode()}")
    sys.stdout.write("\n]\n")
