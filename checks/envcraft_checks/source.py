"""# source

## What it does
Parses the file on the host, looks up each import, then imports the file in the worker and constructs one instance. The
check fails unless the file is Python text that imports without an error and defines exactly one concrete
`gymnasium.Env` whose constructor needs no arguments.

Imports under `try: ... except ImportError`, `with suppress(ImportError):`, `if find_spec(...)`, `if TYPE_CHECKING:` and
`if __name__ == "__main__":` are optional. The handler of such a `try` is required only if the module in its body is
missing or not allowed. Under `if sys.version_info ...`, only the branch that runs is required. An import inside a
function is required as well, unless no code calls the function, or only a `__main__` block does.

Abstract bases, wrappers, private classes (`_Base`) and helper classes do not count as environments. `--class` selects
one of several classes. In a folder, a class is skipped if an environment of another file derives from it, and it has no
`reset` or no `step`, or one of them calls a method that only raises NotImplementedError.

For a class of an installed package, or a registered id, the check judges only what prevents construction: an import
that raises, a class that is missing or does not derive from `gymnasium.Env`, a constructor that raises or needs
arguments. If a library that the package needs is not installed, the environment cannot be judged.

## Why is this bad?
An agent cannot train on an environment that does not load. A missing library, or code that runs for minutes at import,
stops every worker of a cluster.

## Comments
`# envcraft: ignore[EC203] the order is not seen` ignores a finding: on the line that the finding names, on a line of
its own above it, or on the first line of the class or function around it. `# envcraft: ignore-file[EC203] ...` ignores
it in the whole file. Only commands for authors, such as `envcraft validate`, read these comments; audits do not. Two
kinds of comments are warnings: a comment that is malformed, names an unknown rule or gives no reason (EC011), and a
comment that matches no finding (EC012, not at the budget `quick`). A comment without a reason still ignores the
finding.

## Example
```python
import gym_helpers        # EC002: this library does not exist

class Snake(gym.Env):
    def __init__(self, size):  # EC007: gymnasium.make() passes no size
        ...
```
"""

from __future__ import annotations

import ast
import contextlib
import io
import re
import tokenize
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.errors import UsageError, WorkerLost
from envcraft.judging.check import Check, Rule
from envcraft.model.job import ExitReason
from envcraft.model.project import module_name
from envcraft.model.target import MAX_SOURCE, Kind, nodes, parse
from envcraft.model.verdict import Finding, Line, Severity, Verdict
from envcraft.plugins import hookimpl
from envcraft.text import with_article

from .imports import imported_modules, required_imports
from .libraries import (
    ask_for_dependency,
    in_package,
    installation_hint,
    is_on_host,
    is_standard,
    near_module,
    well_known,
    why_unknown,
)
from .linting.loading import import_code, method_code, printing_line, seeding_line, waiting_line
from .linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.description import Description, Effects, UnfinishedClass
    from envcraft.judging.facts import Loaded
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Fault
    from envcraft.model.verdict import CheckReport

_SLOW_IMPORT = 3.0
#: The most characters of the constructor's arguments in a message.
_LONGEST = 200
#: What gymnasium.make adds to an error, with arguments that the user did not give.
_MADE = " was raised from the environment creator"
#: The worker's words for a name that has one like it, or whose package is there.
_MISSPELT = re.compile(r"did you mean|^the package |^No module named '[\w.]+\.\w+'")
#: What to do about a name of something else.
_NAME_A_CLASS = "name a class that derives from gymnasium.Env"
#: The base class of environments, as a class statement names it.
_ENV = re.compile(r"((gym|gymnasium)(\.core)?\.)?Env(\[.*\])?")


class Source(Check):
    name = "source"
    gate = True
    rules = (
        Rule("EC001", "syntax-error", "The file is not valid Python text.", "Fix the line that the finding names."),
        Rule(
            "EC002",
            "unknown-import",
            "The file imports an unknown library.",
            "Import only what the contract allows, or correct the name.",
        ),
        Rule(
            "EC003",
            "import-raises",
            "Importing the file raises an exception.",
            "Fix the line that raises: the finding's, or that of another file that its message names.",
        ),
        Rule(
            "EC004",
            "import-never-ends",
            "Importing the file does not end.",
            'Move code from module level into methods, or under `if __name__ == "__main__":`.',
        ),
        Rule(
            "EC005",
            "no-environment",
            "The file defines no environment class.",
            "Derive a class from gymnasium.Env, and define reset and step.",
        ),
        Rule(
            "EC006",
            "several-environments",
            "The file defines more than one concrete environment class.",
            "Keep one, make the others abstract or private, or select one with --class.",
        ),
        Rule(
            "EC007",
            "constructor-arguments",
            "The constructor needs arguments.",
            "Give every parameter of the constructor a default, or pass values with --kwargs.",
        ),
        Rule(
            "EC008",
            "constructor-raises",
            "The constructor raises or does not end.",
            "Fix the finding's line, or that of another file that its message names.",
        ),
        Rule(
            "EC009",
            "import-side-effects",
            "Loading the file prints, starts threads, seeds global generators or is slow.",
            "Print nothing, and do the rest in the class, not at import.",
            Severity.WARNING,
        ),
        Rule("EC010", "too-large", "The file is too large to be an environment.", "Keep data out of the source."),
        Rule(
            "EC011",
            "ignore-comment",
            "An ignore comment is malformed, names an unknown rule or gives no reason.",
            "Write `# envcraft: ignore[CODE] the reason`.",
            Severity.WARNING,
        ),
        Rule(
            "EC012",
            "unused-ignore",
            "A comment ignores a finding that does not occur.",
            "Remove the code from the comment.",
            Severity.WARNING,
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if subject.target.kind is not Kind.SOURCE:
            yield from self._judge_installed(subject, subject.load())
            return
        if len(subject.target.source) > MAX_SOURCE:
            yield self.finding("EC010", f"the file has more than {MAX_SOURCE // 1024**2} MiB")
            return
        wrong = self._parse(subject.target.source)
        if wrong is not None:
            yield wrong
            return
        yield from self._judge_comments(subject)
        unknown = list(self._unknown_imports(subject))
        yield from unknown
        if not unknown:
            yield from self._judge_loaded(subject, subject.load())

    def conclude(self, subject: Subject, reports: Sequence[CheckReport]) -> Iterator[Finding]:
        comments = subject.ignore_comments
        # What is rare may show only at a larger budget.
        if comments is None or subject.budget.name == "quick" or subject.time_limit.decided:
            return
        passed = {report.check for report in reports if report.verdict is Verdict.PASS}
        settled = {code for code, check in _owners().items() if check.name in passed and check.waivable(code)}
        for comment, code in comments.unused():
            if code in settled and code not in subject.contract.without:
                words = f"line {comment.line} ignores {code}, but {code} does not occur"
                yield self.finding("EC012", words, line=comment.line)

    def _judge_comments(self, subject: Subject) -> Iterator[Finding]:
        from envcraft.judging.selection import like_a_rule

        if subject.ignore_comments is None or not subject.ignore_comments.comments:
            return
        owners = _owners()
        for comment in subject.ignore_comments.comments:
            wrong = [
                f"it needs whole codes, such as {next(each for each in owners if each.startswith(code))}, not {code}"
                if any(each.startswith(code) for each in owners)
                else f"there is no rule {like_a_rule(code, [*owners.values()])}"
                for code in comment.codes
                if code not in owners
            ]
            wrong += [
                f"{code} cannot be ignored, because other verdicts depend on it"
                for code in comment.codes
                if code in owners and not owners[code].waivable(code)
            ]
            if not comment.codes:
                wrong.append("it names no code")
            words = f"the ignore comment in line {comment.line}"
            if wrong:
                yield self.finding("EC011", f"{words} is invalid: {'; '.join(wrong)}", line=comment.line)
            elif not comment.reason:
                yield self.finding("EC011", f"{words} gives no reason", line=comment.line)

    def _parse(self, source: bytes) -> Finding | None:
        try:
            text = source.decode("utf-8-sig")
            # Python refuses a file whose comment declares an encoding that it does not know.
            tokenize.detect_encoding(io.BytesIO(source).readline)
            parse(text)
        except UnicodeDecodeError as error:
            line = source.count(b"\n", 0, error.start) + 1
            return self.finding("EC001", f"the byte {source[error.start]:#04x} is not UTF-8 text", line=line)
        except SyntaxError as error:
            # Python 3.11 reports a null byte without its line, and an encoding never has one.
            line = error.lineno or _line_of(source, b"coding" if "encoding" in error.msg else b"\0")
            return self.finding("EC001", error.msg, line=line)
        except (ValueError, RecursionError, MemoryError) as error:
            line = _line_of(source, b"\0")
            return self.finding("EC001", f"not Python source: {error or 'nested too deeply'}", line=line)
        return None

    def _unknown_imports(self, subject: Subject) -> Iterator[Finding]:
        project = subject.target.project
        own = project.modules if project is not None else frozenset()
        trees = {"": parse(subject.text)}
        for path, data in sorted(project.files.items()) if project is not None else ():
            # Importing a file that is not Python raises EC003, with its traceback.
            with contextlib.suppress(SyntaxError, ValueError, RecursionError, MemoryError):
                trees |= {f"{path} ": parse(data)} if path.endswith(".py") else {}
        names = {name for tree in trees.values() for node in nodes(tree) for name in imported_modules(node)} - own
        missing, known = subject.find_modules(sorted(names))
        allowed = subject.contract.libraries
        unknown = {
            name for name in names if name in missing or not (allowed is None or name in allowed or is_standard(name))
        }
        if unknown and _is_script(subject):
            # What its imports would do does not matter: nothing here can be an environment.
            yield self._wrong_count([], {}, subject)
            return
        python = tuple(int(part) for part in re.findall(r"\d+", str(subject.about.get("python", "")))[:3])
        installable = (well_known() if allowed is None else {*allowed}) - own
        for file, tree in trees.items():
            wanted = required_imports(tree, unknown, python)
            for name, line in sorted(wanted.items(), key=lambda item: item[1]):
                if name in missing and (name in installable or (allowed is None and is_on_host(name))):
                    raise WorkerLost(f"{name} is not installed where the worker runs{installation_hint(subject)}")
                if name in unknown:
                    shown = in_package(tree, name, line)
                    why = why_unknown(name, subject, known, shown, name not in missing)
                    words = f"{file}line {line} imports {shown}, {why}"
                    yield self.finding("EC002", words, line=None if file else line, module=name)

    def _judge_loaded(self, subject: Subject, loaded: Loaded) -> Iterator[Finding]:
        fault, end, description = loaded.trace.fault, loaded.end, loaded.description
        if end.reason is not ExitReason.DONE:
            yield self._broken(subject, loaded)
            return
        if fault is not None and fault.phase == "import":
            words = f"importing raises {subject.raised(fault)}"
            hint = near_module(fault.module, Path(subject.target.path)) if fault.type == "ModuleNotFoundError" else ""
            hint += "; the file defines no class that could be an environment" if _is_script(subject) else ""
            yield self.finding("EC003", f"{words}{hint}", line=fault.line, **fault.evidence)
            return
        yield from self._judge_effects(subject, description.get("effects", {}), end.output)
        classes = [entry["name"] for entry in description.get("classes", [])]
        if subject.target.env_class is None and len(classes) != 1:
            yield self._wrong_count(classes, description, subject)
            return
        if subject.target.env_class is not None and "class" not in description:
            yield self.finding("EC005", f"the file defines no class {subject.target.env_class}", classes=classes)
            return
        if description.get("environment") is False:
            words = f"{subject.env_class} does not derive from gymnasium.Env"
            if not description.get("lookalikes"):
                raise UsageError(f"{words}, and has no reset() and no step(); {_NAME_A_CLASS}", setting="class")
            yield self.finding("EC005", words, line=subject.line_of())
        elif description.get("required"):
            yield self._needs(subject.env_class, subject)
        elif fault is not None:
            _refuse_options(subject, fault)
            given = _given(subject)
            words = f"{subject.env_class}({given}) raises {subject.raised(fault)}"
            if fault.phase == "spaces":
                new = f"{subject.env_class}({given})" if given else subject.env_class
                words = f"reading the spaces of a new {new} raises {subject.raised(fault)}"
            yield self.finding("EC008", words, line=fault.line or subject.line_of(), **fault.evidence)

    def _judge_installed(self, subject: Subject, loaded: Loaded) -> Iterator[Finding]:
        """Judge only what prevents the construction of an installed environment, not how its code is written."""
        fault, description, name = loaded.trace.fault, loaded.description, subject.target.path
        if fault is not None and not _absent(fault, name):
            ask_for_dependency(subject, fault)
            _refuse_options(subject, fault)
        if loaded.end.reason is not ExitReason.DONE:
            yield self._broken(subject, loaded)
        elif fault is not None and _absent(fault, name):
            if _MISSPELT.search(fault.message):
                raise UsageError(fault.message)
            raise WorkerLost(f"{fault.message}{installation_hint(subject)}")
        elif fault is not None and fault.type.endswith("NoSuchEnvironment"):
            raise UsageError(fault.message)
        elif fault is not None and fault.phase == "import":
            words = f"importing raises {subject.raised(fault)}"
            yield self.finding("EC003", words, line=fault.line, **fault.evidence)
        elif description.get("environment") is False:
            made = str(description.get("made"))
            if subject.target.kind is Kind.MODULE and not description.get("lookalikes"):
                raise UsageError(
                    f"{name} makes {with_article(made)}, which has no reset() and no step(); {_NAME_A_CLASS}"
                )
            words = f"{name} constructs {with_article(made)}, which does not derive from gymnasium.Env"
            yield self.finding("EC005", words, line=subject.line_of())
        elif required := description.get("required"):
            if "module" not in description:
                words = f"{name} is a function that needs arguments ({', '.join(required)}); {_NAME_A_CLASS}"
                raise UsageError(f"{words}, or pass them with --kwargs if it makes an environment")
            yield self._needs(name, subject)
        elif fault is not None:
            line, given = fault.line or subject.line_of(), _given(subject)
            words = f"constructing {name}{f' with {given}' if given else ''} raises {subject.raised(fault)}"
            yield self.finding("EC008", words, line=line, **fault.evidence)

    def _needs(self, name: str | None, subject: Subject) -> Finding:
        description = subject.load().description
        required = description["required"]
        if (wrapper := description["class"]) in description.get("wrappers", []):
            if subject.target.kind is Kind.MODULE:
                raise UsageError(_wrapper(subject, wrapper))
            return self.finding("EC005", _wrapper(subject, wrapper), line=subject.line_of())
        words = f"{name}() needs {', '.join(required)}"
        return self.finding("EC007", words, line=subject.line_of("__init__"), required=required)

    def _broken(self, subject: Subject, loaded: Loaded) -> Finding:
        end = loaded.end
        where = "the constructor" if end.phase == "construct" else "importing the file"
        line: int | Line | None = subject.line_of() if end.phase == "construct" else None
        if end.reason is ExitReason.TIMEOUT:
            code = "EC008" if end.phase == "construct" else "EC004"
            if (program := program_of(subject)) is not None:
                line = waiting_line(program, end.stack) or line
            return self.finding(code, f"{where} did not end: {end.detail}", line=line, output=end.output[-2000:])
        code = "EC008" if end.phase == "construct" else "EC003"
        words = f"{where} ended the process ({end.reason}: {end.detail})"
        return self.finding(code, words, line=next(iter(end.stack), line), output=end.output[-2000:])

    def _judge_effects(self, subject: Subject, effects: Effects, output: str) -> Iterator[Finding]:
        found, line, constructor = [], None, ""
        if output.strip():
            prints = f"prints {output.strip().splitlines()[0][:60]!r}"
            if (program := program_of(subject)) is not None:
                imported = list(import_code(program))
                line = printing_line(program, [*imported, *method_code(program, "__init__")], output)
                if line is not None and printing_line(program, imported, output) is None:
                    constructor = f"the constructor {prints}"
            if not constructor:
                found.append(prints)
        if effects.get("random") or effects.get("numpy_random"):
            found.append("changes the global random generators")
            if line is None and (program := program_of(subject)) is not None:
                line = seeding_line(program)
        if (threads := effects.get("threads", 0)) > 0:
            found.append(f"starts {threads} threads")
        seconds = effects.get("seconds", 0.0)
        if seconds > _SLOW_IMPORT:
            found.append(f"takes {seconds:.1f} s without the libraries that it imports")
        if found or constructor:
            loading = [f"loading the file {' and '.join(found)}"] if found else []
            words = ", and ".join([*loading, *([constructor] if constructor else [])])
            yield self.finding("EC009", words, line=line, **effects)

    def _wrong_count(self, classes: list[str], description: Description, subject: Subject) -> Finding:
        if classes:
            words = f"the file defines {len(classes)} environments: {', '.join(classes)}"
            # The first one that is too many.
            return self.finding("EC006", words, line=description["classes"][1]["line"], classes=classes)
        tree = parse(subject.text)
        lines = {node.name: node.lineno for node in tree.body if isinstance(node, ast.ClassDef)}
        alike = description.get("lookalikes", [])
        hint = f"; {', '.join(alike)} has reset and step but does not derive from gymnasium.Env" if alike else ""
        line = lines.get(alike[0]) if alike else None
        if not hint and (unfinished := description.get("unfinished")):
            line, hint = unfinished[0]["line"], f"; {_left_open(unfinished[0])}"
        elif not hint and (wrappers := description.get("wrappers")):
            line = lines.get(wrappers[0])
            hint = f"; {_wrapper(subject, wrappers[0])}"
        elif not hint and (made := next(_made(tree), None)) is not None:
            line, function, name = made
            step = (
                "define it at the top level" if (to := _bound(tree, function)) is None else f"name it with --class {to}"
            )
            hint = f"; {function}() makes the class {name}: {step}"
        words = f"the file defines no concrete subclass of gymnasium.Env with reset and step{hint}"
        return self.finding("EC005", words, line=line)


def _line_of(source: bytes, part: bytes) -> int:
    """The line of the first occurrence of a part, or 1."""
    return source.count(b"\n", 0, source.find(part)) + 1 if part in source else 1


def _owners() -> dict[str, Check]:
    """The check of each code."""
    from envcraft.judging.selection import all_checks

    return {rule.code: check for check in all_checks() for rule in check.rules}


def _absent(fault: Fault, name: str) -> bool:
    """Whether the target's package or environment is not installed, which is not the environment's fault."""
    if fault.phase == "import" and fault.type == "ModuleNotFoundError":
        module = name.partition(":")[0]
        parents = [module.rsplit(".", number)[0] for number in range(module.count(".") + 1)]
        return any(fault.message == f"No module named {parent!r}" for parent in parents)
    return fault.type.endswith("NoSuchEnvironment") and fault.message.startswith(
        ("no installed package", "the package")
    )


def _left_open(unfinished: UnfinishedClass) -> str:
    """What a class leaves to subclasses, in words."""
    name, parts = unfinished["name"], []
    if unfinished["lacks"]:
        parts.append(f"has no {' and no '.join(unfinished['lacks'])}")
    if unfinished["abstract"]:
        methods = [f"{each}(){'' if owner == name else f' of {owner}'}" for each, owner in unfinished["abstract"]]
        parts.append(f"leaves {' and '.join(methods)} abstract")
    return f"{name} {' and '.join(parts)}"


def _made(tree: ast.Module) -> Iterator[tuple[int, str, str]]:
    """The line, the function and the name of each class of environments that a function defines."""
    for function in (each for each in tree.body if isinstance(each, ast.FunctionDef)):
        for node in ast.walk(function):
            if isinstance(node, ast.ClassDef) and any(_ENV.fullmatch(ast.unparse(base)) for base in node.bases):
                yield node.lineno, function.name, node.name


def _bound(tree: ast.Module, function: str) -> str | None:
    """The name that a module gives to the result of one of its functions."""
    for node in tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(func=ast.Name(id=called))) if (
                called == function
            ):
                return name
    return None


def _given(subject: Subject) -> str:
    """The arguments that the user gives the constructor, as a call has them."""
    words = ", ".join(f"{name}={value!r}" for name, value in subject.target.kwargs.items())
    return words if len(words) <= _LONGEST else f"{words[:_LONGEST]}..."


def _wrapper(subject: Subject, name: str) -> str:
    """How to judge a wrapper of the target's file or package."""
    options = f"--wrap {subject.target.path}"
    if subject.target.kind is Kind.SOURCE:
        contract = "" if subject.contract.project else " --contract gymnasium"
        options = f"--wrap {module_name(Path(subject.target.path))}:{name}{contract}"
    return f"{name} is a wrapper; to judge it, validate an environment with {options}"


def _is_script(subject: Subject) -> bool:
    """Whether no class is chosen in a file, and nothing in it can be an environment.

    No class of it derives from anything, and nothing is imported from beside it.
    """
    if subject.target.env_class is not None:
        return False
    return not any(
        (isinstance(node, ast.ClassDef) and node.bases) or (isinstance(node, ast.ImportFrom) and node.level)
        for node in nodes(parse(subject.text))
    )


def _refuse_options(subject: Subject, fault: Fault) -> None:
    """Raise UsageError if a wrapper or an argument of the constructor that the user names does not exist."""
    if subject.target.wrappers and fault.type.endswith("targets.NoSuchWrapper"):
        own = subject.left_out.modules if subject.left_out is not None else ()
        if wrapper := next((each for each in subject.target.wrappers if re.split(r"[.:]", each)[0] in own), None):
            raise UsageError(
                f"--wrap {wrapper} is in a file of the project, and the contract {subject.contract.name} is for single "
                "files; name --contract gymnasium"
            )
        raise UsageError(f"--wrap: {fault.message}")
    refusals = ("unexpected keyword argument", "multiple values for argument")
    unknown = any(f"{words} {name!r}" in fault.message for words in refusals for name in subject.target.kwargs)
    # An error that a line of the environment raises is its own.
    if unknown and fault.type == "TypeError" and fault.line is None:
        raise UsageError(f"--kwargs: {fault.message.partition(_MADE)[0]}")


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Source()]
