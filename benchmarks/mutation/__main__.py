"""``python -m benchmarks.mutation``: what EnvCraft and its peers find of defects that are planted in good games.

Each operator makes mutants of each game. A mutant is *caught* if an error has a code that names the planted defect. A
mutant that is not caught is replayed beside its game under many conditions; one that never differs is equivalent and
set aside. One that does not load does not count. The games themselves are judged with 20 values of ``--seed``.

The peers have no codes: any complaint counts that they do not make about the unchanged game, which favours them. The
exit status is 1 if recall is below the limit of a budget, or if a game that was not changed fails.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import random
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import msgspec
from rich.console import Console

from benchmarks.mutation.equivalence import equivalent
from benchmarks.mutation.games import Game, games
from benchmarks.mutation.operators import OPERATORS
from benchmarks.mutation.results import Result, append, key, read
from benchmarks.mutation.source import Source
from benchmarks.mutation.table import broken, by_operator, by_rule
from benchmarks.peers import complaints
from benchmarks.third_party import code_digest
from envcraft.contracts.lookup import contract_named
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Driver
from envcraft.judging.engine import Plan, judge
from envcraft.judging.selection import default_checks, driver_named
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import SubjectFinished
from envcraft.model.target import read_target
from envcraft.model.verdict import Severity, SubjectReport

#: Values of ``--seed`` with which the unchanged games are judged.
_SEEDS = 20


@dataclass(frozen=True)
class Mutant:
    """A text to judge; that of the game itself has no operator."""

    operator: str
    game: Game
    number: int
    text: str
    seed: int


def mutants(operators: Sequence[str], chosen: Sequence[Game], sample: int | None, seed: int) -> Iterator[Mutant]:
    """The mutants of some operators and games: all of them, or up to `sample` of each operator, of different games."""
    sources = {game: Source(game.path.read_text("utf-8")) for game in chosen}
    for name in operators:
        made = [(game, OPERATORS[name].mutants(source)) for game, source in sources.items()]
        drawn = random.Random(f"{seed} {name}")
        if sample is not None:
            drawn.shuffle(made)
            made = [(game, texts) for game, texts in made if texts][:sample]
        for game, texts in made:
            numbers = range(len(texts)) if sample is None else [drawn.randrange(len(texts))]
            for number in numbers:
                yield Mutant(name, game, number, texts[number], seed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; return 1 where a limit is exceeded."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutation", description=__doc__)
    parser.add_argument("--budget", action="append", choices=list(BUDGETS), help="default: standard")
    parser.add_argument("--operator", action="append", choices=list(OPERATORS), help="default: all")
    parser.add_argument("--game", action="append", help="default: all")
    parser.add_argument("--folder", type=Path, help="mutate the games of this folder that pass, and not the usual ones")
    parser.add_argument("--sample", type=int, help="up to so many mutants of each operator")
    parser.add_argument("--seed", type=int, default=0, help="of the sample and of the validations")
    parser.add_argument("--seeds", type=int, default=_SEEDS, help="values of --seed for the unchanged games")
    parser.add_argument("--sandbox", default="auto")
    parser.add_argument("--jobs", type=int, default=2, help="mutants that are judged at a time")
    parser.add_argument("--results", type=Path, help="keep results in this file and continue from it")
    parser.add_argument(
        "--missed", action="store_true", help="list the mutants that are not caught, with the lines that are new"
    )
    parser.add_argument("--write", type=Path, help="write the mutants into this folder and judge nothing")
    options = parser.parse_args(arguments)
    chosen = [game for game in games(options.folder) if options.game is None or game.name in options.game]
    texts = {game: game.path.read_text("utf-8") for game in chosen}
    wanted = [Mutant("", game, 0, text, seed) for seed in range(options.seeds) for game, text in texts.items()]
    wanted += mutants(options.operator or list(OPERATORS), chosen, options.sample, options.seed)
    if options.write:
        options.write.mkdir(parents=True, exist_ok=True)
        for mutant in wanted:
            _path(options.write, mutant).write_text(mutant.text, "utf-8")
        return 0
    exceeded = []
    for budget in options.budget or ["standard"]:
        results = _judged(wanted, budget, options)
        if options.folder:
            results = _of_passing(results)
        console = Console(width=140)
        console.print(by_operator(results, budget))
        console.print(by_rule(results, budget))
        by_name = {(mutant.operator, mutant.game.name, mutant.number): mutant for mutant in wanted}
        for result in results if options.missed else ():
            mutant = by_name[result.operator, result.game, result.number]
            if result.operator and result.counts and not result.caught:
                codes = " ".join([*result.errors, *(f"({code})" for code in result.warnings)])
                print(f"missed: {result.operator} {result.game} {result.number}: {codes or 'nothing'}")
                for line in difflib.ndiff(texts[mutant.game].splitlines(), mutant.text.splitlines()):
                    if line.startswith("+ ") and line.strip() != "+":
                        print(f"    {line}")
        exceeded += broken(results, budget)
    print(*exceeded, sep="\n")
    return int(bool(exceeded))


def _of_passing(results: Sequence[Result]) -> list[Result]:
    """The results on the games that pass, and on their mutants."""
    failing = {result.game for result in results if not result.operator and result.verdict != "pass"}
    return [result for result in results if result.game not in failing]


def _judged(wanted: Sequence[Mutant], budget: str, options: argparse.Namespace) -> list[Result]:
    """Judge what the results file does not have yet."""
    known, code = read(options.results), code_digest()
    keys = {mutant: key(mutant.operator, mutant.text, budget, mutant.seed, code) for mutant in wanted}
    missing = [mutant for mutant, own in keys.items() if own not in known]
    started = time.monotonic()
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        driver = stack.enter_context(contextlib.closing(driver_named(options.sandbox)))
        for mutant in missing:
            _path(folder, mutant).write_text(mutant.text, "utf-8")
        # Before there are threads, because each peer runs in a fork.
        said = complaints([_path(folder, mutant) for mutant in missing if mutant.game.contract == "arcade"])
        judging = _Judging(driver, budget, folder, code, said)
        stack.enter_context(judging.pool)
        threads = stack.enter_context(ThreadPoolExecutor(options.jobs))
        running = [threads.submit(judging.result, mutant) for mutant in missing]
        try:
            for number, done in enumerate(as_completed(running), 1):
                result = done.result()
                append(options.results, result)
                known[result.key] = result
                each = (time.monotonic() - started) / number
                codes = " ".join(result.errors) or ("equivalent" if result.equivalent else "nothing")
                print(
                    f"{budget}: {number} of {len(missing)}, {each * (len(missing) - number) / 60:.0f} minutes left: "
                    f"{result.operator or 'unchanged'} {result.game}: {codes}",
                    file=sys.stderr,
                )
        finally:
            threads.shutdown(cancel_futures=True)
    return [known[own] for own in keys.values()]


class _Judging:
    """Judges mutants with one pool of workers."""

    def __init__(self, driver: Driver, budget: str, folder: Path, code: str, said: dict[str, dict[str, str]]) -> None:
        self.driver, self.budget, self.folder, self.code, self.said = driver, budget, folder, code, said
        # More than one subject, so that the workers come from a zygote, as in an audit.
        self.pool = WorkerPool(driver, subjects=2)

    def result(self, mutant: Mutant) -> Result:
        path = _path(self.folder, mutant)
        report = self._report(self._plan(path, mutant))
        codes: dict[Severity, set[str]] = {Severity.ERROR: set(), Severity.WARNING: set()}
        for check in report.checks:
            for finding in check.findings:
                codes[finding.severity].add(finding.code)
        result = Result(
            mutant.operator,
            mutant.game.name,
            mutant.number,
            *key(mutant.operator, mutant.text, self.budget, mutant.seed, self.code)[1:],
            errors=sorted(codes[Severity.ERROR]),
            warnings=sorted(codes[Severity.WARNING] - codes[Severity.ERROR]),
            verdict=report.verdict.value,
            steps=report.steps,
            seconds=report.seconds,
            peers=self.said.get(str(path), {}),
        )
        if mutant.operator and result.loads and not result.caught and not OPERATORS[mutant.operator].silent:
            original = self._plan(mutant.game.path, mutant)
            same = equivalent(original, self._plan(path, mutant), self.pool)
            result = msgspec.structs.replace(result, equivalent=same)
        return result

    def _plan(self, path: Path, mutant: Mutant) -> Plan:
        return Plan(
            [read_target(str(path))],
            contract_named(mutant.game.contract),
            self.driver,
            default_checks(),
            BUDGETS[self.budget],
            seed=mutant.seed,
            parallel_jobs=1,
        )

    def _report(self, plan: Plan) -> SubjectReport:
        *_, last = judge(plan, plan.targets[0], self.pool)
        assert isinstance(last, SubjectFinished)
        return last.report


def _path(folder: Path, mutant: Mutant) -> Path:
    return folder / f"{mutant.operator or 'unchanged'}-{mutant.game.name}-{mutant.number}-{mutant.seed}.py"


if __name__ == "__main__":
    raise SystemExit(main())
