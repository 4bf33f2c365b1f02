"""``envcraft corpus``: the commands that keep a corpus; those that compare its environments lie beside."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import msgspec

from envcraft.cli import unknown
from envcraft.commands.choices import all_checks
from envcraft.commands.outputs import whole
from envcraft.commands.targets import environments_below
from envcraft.corpus.history import told as told_of
from envcraft.corpus.history import words as words_of
from envcraft.corpus.likeness_commands import dedup, diversity, split
from envcraft.corpus.report.command import report
from envcraft.corpus.store import DATABASE, SOURCES, CorpusDamaged, Store, decode, find, is_corpus
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.reports import one_line, plural, printable
from envcraft.target import MAX_SOURCE, Target, read_target
from envcraft.verdict import Verdict, plain

_FORMAT = click.option("--format", "form", type=click.Choice(["table", "json"]), default="table", show_default=True)
_CORPUS = click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
#: Environments with the last verdict on each, which is out of date once the source or the class has changed.
_LISTED = (
    "SELECT name, environments.source, environments.class, added, "
    "verdicts.verdict AS judged, steps, seconds, "
    "(SELECT group_concat(code, ' ') FROM (SELECT DISTINCT code FROM findings "
    "WHERE findings.verdict = verdicts.id ORDER BY code)) AS codes "
    "FROM environments LEFT JOIN verdicts ON verdicts.id = environments.verdict "
    "AND verdicts.source = environments.source AND verdicts.class = environments.class"
)


@click.command()
@_CORPUS
def init(corpus: Path) -> None:
    """Make an empty corpus in a new folder."""
    Store.create(corpus).close()
    click.echo(f"{corpus} is a corpus; `envcraft corpus add {corpus} FOLDER` adds environments")


@click.command()
@_CORPUS
@click.argument("paths", metavar="FILE|FOLDER...", nargs=-1, required=True)
@click.option("--class", "env_class", metavar="NAME", default="", help="The class to judge, where a file has several.")
@click.option("--metadata", metavar="JSON", help="An object to keep with each: where it comes from, say.")
@click.option("--replace", is_flag=True, help="Put files in the place of others that have their names.")
@click.pass_context
def add(
    ctx: click.Context, corpus: Path, paths: tuple[str, ...], env_class: str, metadata: str | None, replace: bool
) -> None:
    """Add files, by their names, and the environments below folders, by their paths in there.

    A source that the corpus has already is named and left out.
    """
    told = _metadata(metadata)
    for path in paths:
        # Its sources have digests for names, and what is known of them is not in them.
        if is_corpus(Path(path)):
            raise UsageError(f"{path} is a corpus; `envcraft corpus merge {corpus} {path}` takes its environments over")
    added, known, refused = 0, 0, 0
    with Store(corpus, write=True) as store:
        if store.follows_folder:
            raise UsageError(f"{corpus} follows a folder: put files there, and `envcraft audit` finds them")
        for name, target in _files(paths):
            found = store.db.execute("SELECT source, class FROM environments WHERE name = ?", (name,)).fetchone()
            twins = [twin for twin in store.twins(target.source, env_class) if twin != name]
            if len(target.source) > MAX_SOURCE:
                words = f"{target.path} is larger than {MAX_SOURCE:,} bytes: no environment is"
                click.echo(f"Error: {one_line(words)}", err=True)
                refused += 1
            elif twins and (found is None or not replace):
                click.echo(f"{one_line(target.path)} is the same as {one_line(twins[0])}, and left out", err=True)
                known += 1
            elif found not in (None, (target.sha256, env_class)) and not replace:
                other = "source" if found[0] != target.sha256 else "class of this source"
                words = f"{name} is another {other} in {corpus}; --replace puts {target.path} there"
                click.echo(f"Error: {one_line(words)}", err=True)
                refused += 1
            else:
                origin = {"file": target.path, **told}
                fresh = _put(store, name, target, env_class, origin)
                if not fresh and replace:
                    store.describe(name, origin)
                added, known = added + fresh, known + (not fresh)
        store.prune()
    click.echo(f"{plural(added, 'environment')} added, {known:,} there already")
    ctx.exit(ExitCode.USAGE if refused else ExitCode.PASS)


@click.command(name="list")
@_CORPUS
@click.option("--verdict", type=click.Choice([*(v.value for v in Verdict if v is not Verdict.SKIP), "none"]))
@click.option("--code", metavar="CODE", help="Only those in which this was found, such as EC203.")
@click.option("--name", metavar="GLOB", help="Only those with such a name, like 'games/*'.")
@_FORMAT
def list_(corpus: Path, verdict: str | None, code: str | None, name: str | None, form: str) -> None:
    """List environments with the last verdict on each; "none" where there is none on the present source."""
    conditions, values = ["1"], []
    if verdict == "none":
        conditions.append("judged IS NULL")
    elif verdict is not None:
        conditions.append("judged = ?")
        values.append(verdict)
    if code is not None:
        conditions.append("verdicts.id IN (SELECT verdict FROM findings WHERE code = ?)")
        values.append(code.upper())
    if name is not None:
        conditions.append("name GLOB ?")
        values.append(plain(name))
    query = f"{_LISTED} WHERE {' AND '.join(conditions)} ORDER BY name"
    with Store(corpus) as store:
        if code is not None:
            _known(store, code)
        rows = store.db.execute(query, values)
        if form == "json":
            _write_array(_row(row) for row in rows)
            return
        for row in rows:
            told = _row(row)
            click.echo(f"{told['verdict'] or 'none':5}  {one_line(told['name'])}  {' '.join(told['codes'])}".rstrip())


def _known(store: Store, code: str) -> None:
    """Raises UsageError on a code that is no rule's, nor found in the corpus by a plugin that is not here now."""
    rules = {rule.code for check in all_checks() for rule in check.rules}
    found = {row[0] for row in store.db.execute("SELECT DISTINCT code FROM findings")}
    if code.upper() not in rules | found:
        raise UsageError(f"there is no rule {unknown(code, sorted(rules | found))}")


@click.command()
@_CORPUS
@click.argument("name")
@click.option("--source", is_flag=True, help="Write the source itself.")
@_FORMAT
def show(corpus: Path, name: str, source: bool, form: str) -> None:
    """Show one environment, every verdict on its source, and where it was generated, how it came about."""
    with Store(corpus) as store:
        spelt = (plain(name), plain(f"{name}.py"))
        row = store.db.execute(f"{_LISTED} WHERE name IN (?, ?) ORDER BY name = ? DESC", (*spelt, spelt[0])).fetchone()
        if row is None:
            raise UsageError(f"{corpus} has no environment {name}; `envcraft corpus list {corpus}` lists them")
        if source:
            sys.stdout.flush()
            sys.stdout.buffer.write(store.source(row[1]))
            return
        (origin,) = store.db.execute("SELECT origin FROM environments WHERE name = ?", (row[0],)).fetchone()
        origin = json.loads(origin)
        history = told_of(store, str(origin.get("concept", "")))
        found = store.db.execute(
            "SELECT contract, budget, seed, driver, rules, image, report FROM verdicts "
            "JOIN settings ON settings.id = verdicts.settings WHERE source = ? AND class = ? ORDER BY verdicts.id",
            (row[1], row[2]),
        ).fetchall()
    keys = ("contract", "budget", "seed", "driver", "rules", "image")
    told = {**_row(row), "origin": origin}
    if form == "json":
        told["verdicts"] = [
            {**dict(zip(keys, found_row, strict=False)), "report": decode(found_row[-1])} for found_row in found
        ]
        if history:
            told["history"] = history
        click.echo(msgspec.json.format(msgspec.json.encode(plain(told)), indent=2))
        return
    judged = next((decode(text).env_class for *_, text in reversed(found)), None) or "-"
    for key in ("name", "source", "class", "added", "origin"):
        value = json.dumps(told[key]) if key == "origin" else told[key] or judged
        click.echo(f"{key:7}  {one_line(value)}".rstrip())
    for *settings, text in found:
        report = decode(text)
        words = ", ".join(f"{key} {value}" for key, value in zip(keys[:5], settings, strict=False))
        click.echo(f"\n{report.verdict.value}  {words}")
        for check in report.checks:
            for finding in check.findings:
                click.echo(f"  {one_line(finding.code)} {finding.severity.value}: {one_line(finding.message)}")
    for line in words_of(history) if history else ():
        click.echo(printable(line.replace("\n", " ")))


@click.command()
@_CORPUS
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@click.pass_context
def rm(ctx: click.Context, corpus: Path, names: tuple[str, ...]) -> None:
    """Remove environments, with the verdicts on them unless another one has the same source."""
    unknown = 0
    with Store(corpus, write=True) as store:
        if store.follows_folder:
            raise UsageError(f"{corpus} follows a folder: remove files there, and `envcraft audit` finds out")
        for name in names:
            if not store.remove(plain(name)):
                click.echo(f"Error: {corpus} has no environment {name}", err=True)
                unknown += 1
    click.echo(f"{plural(len(names) - unknown, 'environment')} removed")
    ctx.exit(ExitCode.USAGE if unknown else ExitCode.PASS)


@click.command()
@_CORPUS
@click.option("--repair", is_flag=True, help="Mend what can be; what is taken out goes into CORPUS/lost+found.")
@click.pass_context
def verify(ctx: click.Context, corpus: Path, repair: bool) -> None:
    """Check every digest, every reference and every verdict.

    \b
    Exit status: 0 all is well, or has been mended    1 there is damage
                 2 wrong use                          3 the corpus cannot be read
    """
    from envcraft.corpus.verify import verify as check

    left = found = 0
    try:
        with Store(corpus, write=True) as store:
            for damage in check(store, repair):
                found += 1
                left += not damage.done
                click.echo(one_line(f"{damage.what}: {damage.done}" if damage.done else damage.what))
            count = store.db.execute("SELECT count(*) FROM environments").fetchone()[0]
    except OSError as error:
        raise EnvCraftError(f"{error.filename or corpus} cannot be read or mended: {error.strerror}") from None
    except CorpusDamaged as error:
        raise CorpusDamaged(f"{error.what}: {_anew(find(corpus))}") from error
    if not found:
        click.echo(f"{plural(count, 'environment')}: all is well")
    elif left and not repair:
        click.echo(f"{left:,} damaged; --repair mends what can be", err=True)
    elif left:
        click.echo(
            f"{left:,} cannot be mended: {_anew(find(corpus))}",
            err=True,
        )
    ctx.exit(ExitCode.FAIL if left else ExitCode.PASS)


@click.command()
@_CORPUS
@click.argument("other", metavar="OTHER", type=click.Path(path_type=Path))
def merge(corpus: Path, other: Path) -> None:
    """Take over the environments and verdicts of another corpus, how they came about, and what models answered."""
    from envcraft.cli import offered
    from envcraft.corpus.merge import merge as take

    with Store(corpus, write=True) as store, Store(other) as source:
        if store.follows_folder:
            raise UsageError(f"{corpus} follows a folder; merge into a corpus that `envcraft corpus init` has made")
        try:
            merged = take(store, source)
            generators = [generator for generator in offered("envcraft_generators") if generator.merge is not None]
            beside = [generator.merge(store.root, source.root) for generator in generators]
        except OSError as error:
            raise EnvCraftError(f"{corpus} cannot be written to: {error.strerror}") from None
    for old, new in merged.renamed:
        click.echo(f"{one_line(old)} is another source here; that of {other} is called {one_line(new)}", err=True)
    found = [plural(merged.added, "environment"), plural(merged.verdicts, "verdict")]
    found += [plural(merged.concepts, "concept")] if merged.concepts else []
    found += filter(None, beside)
    click.echo(f"{', '.join(found[:-1])} and {found[-1]} added")


@click.command()
@_CORPUS
@click.option("--output", type=click.Path(dir_okay=False), default="-", metavar="FILE", help="Where to write.")
def records(corpus: Path, output: str) -> None:
    """Write a validation record for each environment that was judged, as JSON lines that are chained by digests.

    `envcraft reverify` judges again what they say.
    """
    from envcraft.corpus.records import End, chain, encode, records_of

    with Store(corpus) as store, click.open_file("-", "wb") if output == "-" else whole(output) as stream:
        for line in chain(records_of(store)):
            stream.write(encode(line))
    assert isinstance(line, End)
    click.echo(f"{plural(line.records, 'record')}; the digest of all is {line.digest}", err=True)


COMMANDS = (init, add, list_, show, rm, verify, merge, records, dedup, diversity, split, report)


def _files(paths: tuple[str, ...]) -> Iterator[tuple[str, Target]]:
    """What the paths name, each with the name that it gets. Raises UsageError."""
    for path in paths:
        if os.path.isdir(path):
            found = False
            for target in environments_below(path):
                found = True
                yield plain(os.path.relpath(target.path, path)), target
            if not found:
                raise UsageError(f"{path} holds no environment: no .py file below it has a class and names gymnasium")
        else:
            yield plain(os.path.basename(path)), read_target(path)


def _anew(root: Path) -> str:
    """What is left to do where a database is lost."""
    return (
        f"restore {root / DATABASE} from a copy, or make a new corpus of the sources, with `envcraft corpus init NEW` "
        f"and `envcraft corpus add NEW {root / SOURCES}`"
    )


def _put(store: Store, name: str, target: Target, env_class: str, origin: dict[str, Any]) -> bool:
    try:
        return store.add(name, target.source, env_class, origin)
    except OSError as error:
        raise EnvCraftError(f"{target.path} cannot be kept in {store.root}: {error.strerror}") from None


def _metadata(text: str | None) -> dict[str, Any]:
    try:
        value = json.loads(text or "{}")
    except (ValueError, RecursionError) as error:
        raise UsageError(f"--metadata {text} is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise UsageError(f'--metadata {text} is no JSON object; write it like \'{{"model": "a"}}\'')
    return value


def _row(row: tuple[Any, ...]) -> dict[str, Any]:
    name, source, env_class, added, verdict, steps, seconds, codes = row
    return {
        "name": name,
        "source": source,
        "class": env_class or None,
        "added": added,
        "verdict": verdict,
        "steps": steps,
        "seconds": seconds,
        "codes": codes.split() if codes else [],
    }


def _write_array(rows: Iterator[dict[str, Any]]) -> None:
    """A JSON array, one row a line, however many there are."""
    sys.stdout.write("[")
    for number, row in enumerate(rows):
        sys.stdout.write(f"{',' if number else ''}\n{msgspec.json.encode(row).decode()}")
    sys.stdout.write("\n]\n")
