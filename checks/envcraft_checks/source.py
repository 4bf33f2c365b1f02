"""# source

## What it does
Parses the file on the host, looks up each import, then loads it in the worker and constructs one instance. Fails
unless the file is Python text that imports cleanly and holds exactly one concrete `gymnasium.Env` whose constructor
needs nothing.

Imports under `try: ... except ImportError`, `with suppress(ImportError):`, `if find_spec(...)`, `if TYPE_CHECKING:` and
`if __name__ == "__main__":` are optional. What stands in for a module (the handler of such a `try`) is required only
where that module is missing or not allowed, and of `if sys.version_info ...` the branch that runs. An import inside a
function counts like any other, unless only such a `__main__` block calls the function, or nobody.

Abstract bases, wrappers, private classes (`_Base`) and helper classes do not count as environments; `--class` picks
one of several.

Of an installed package's class or a registered id only what keeps it from being made is judged: an import that
raises, a class that is missing or no `gymnasium.Env`, a constructor that raises or lacks arguments. Where it says that
an optional dependency of its own is not installed, here or later, it could not be judged.

## Why is this bad?
What cannot be loaded cannot be trained on. A library that the next machine lacks, or code that runs for minutes at
import, breaks every worker of a cluster.

## Example
```python
import gym_helpers        # EC002: no such library

class Snake(gym.Env):
    def __init__(self, size):  # EC007: gymnasium.make() has no size to give
        ...
```
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

from envcraft.check import Check, Rule
from envcraft.errors import WorkerLost
from envcraft.plugins import hookimpl
from envcraft.sandbox import How, Isolation
from envcraft.target import parse
from envcraft.verdict import Finding, Severity

if TYPE_CHECKING:
    from envcraft.description import Description, Effects
    from envcraft.subject import Loaded, Subject
    from envcraft.trace import Fault

_OLD_NAMES = {"gym": "gymnasium", "pygame_ce": "pygame", "np": "numpy"}
_SLOW_IMPORT = 3.0
#: Methods that Gymnasium's own code calls.
_CALLED = {"reset", "step", "render", "close", "seed", "action", "observation", "reward"}
_ORDERS = {ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge}


class Source(Check):
    name = "source"
    rules = (
        Rule("EC001", "syntax-error", "The file is not valid Python text.", "Correct the line that is named."),
        Rule(
            "EC002",
            "unknown-import",
            "The file imports a library that is not known.",
            "Use the standard library and the contract's libraries, or correct the name.",
        ),
        Rule("EC003", "import-raises", "Importing the file raises an exception.", "Mend the statement that is named."),
        Rule(
            "EC004",
            "import-never-ends",
            "Importing the file does not end.",
            'Move work out of module level: into methods, or under `if __name__ == "__main__":`.',
        ),
        Rule("EC005", "no-environment", "The file defines no environment class.", "Derive a class from gymnasium.Env."),
        Rule(
            "EC006",
            "several-environments",
            "The file defines more than one concrete environment class.",
            "Keep one, make the others abstract or private, or pick one with --class.",
        ),
        Rule(
            "EC007",
            "constructor-arguments",
            "The constructor needs arguments.",
            "Give every parameter of the constructor a default.",
        ),
        Rule("EC008", "constructor-raises", "The constructor raises, or never ends.", "Mend the line that is named."),
        Rule(
            "EC009",
            "import-side-effects",
            "Importing the file prints, starts threads, seeds global generators or is slow.",
            "Import quietly; keep such things in the class.",
            Severity.WARNING,
        ),
        Rule("EC010", "too-large", "The file is too large to be an environment.", "Keep data out of the source."),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        from envcraft.target import MAX_SOURCE, Kind

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
        unknown = list(self._unknown_imports(subject))
        yield from unknown
        if not unknown:
            yield from self._judge_loaded(subject, subject.load())

    def _parse(self, source: bytes) -> Finding | None:
        try:
            text = source.decode("utf-8-sig")
            parse(text)
        except UnicodeDecodeError as error:
            line = source.count(b"\n", 0, error.start) + 1
            return self.finding("EC001", f"byte {source[error.start]:#04x} in line {line} is not UTF-8 text", line=line)
        except SyntaxError as error:
            return self.finding("EC001", f"{error.msg} (line {error.lineno})", line=error.lineno)
        except (ValueError, RecursionError, MemoryError) as error:
            line = source.count(b"\n", 0, source.find(b"\0")) + 1 if b"\0" in source else 1
            return self.finding("EC001", f"not Python source: {error or 'nested too deeply'}", line=line)
        return None

    def _unknown_imports(self, subject: Subject) -> Iterator[Finding]:
        tree = parse(subject.text)
        names = {name for node in ast.walk(tree) for name in _modules(node)}
        missing, known = subject.find_modules(sorted(names))
        allowed = subject.contract.libraries
        unknown = {
            name for name in names if name in missing or not (allowed is None or name in allowed or is_standard(name))
        }
        python = tuple(int(part) for part in re.findall(r"\d+", str(subject.about.get("python", "")))[:3])
        wanted = required_imports(tree, unknown, python)
        for name, line in sorted(wanted.items(), key=lambda item: item[1]):
            if name in missing and allowed is not None and name in allowed:
                raise WorkerLost(f"{name} is not installed where the worker runs; install it, then judge again")
            if name in unknown:
                near = _nearest(name, [*(allowed or ()), *known])
                hint = f"; did you mean {near}?" if near else ""
                yield self.finding(
                    "EC002", f"line {line} imports {name}, which is not known{hint}", line=line, module=name
                )

    def _judge_loaded(self, subject: Subject, loaded: Loaded) -> Iterator[Finding]:
        fault, end, told = loaded.trace.fault, loaded.end, loaded.description
        if end.how is not How.DONE:
            yield self._broken(loaded)
            return
        if fault is not None and fault.phase == "import":
            yield self.finding("EC003", f"importing raises {fault}", line=fault.line, traceback=fault.traceback)
            return
        yield from self._judge_effects(told.get("effects", {}), end.output)
        classes = [entry["name"] for entry in told.get("classes", [])]
        if subject.target.env_class is None and len(classes) != 1:
            yield self._wrong_count(classes, told)
            return
        if subject.target.env_class is not None and "class" not in told:
            yield self.finding("EC005", f"the file defines no class {subject.target.env_class}", classes=classes)
            return
        if told.get("required"):
            yield self._needs(subject.env_class, told)
        elif fault is not None:
            words = f"{subject.env_class}() raises {fault}"
            yield self.finding("EC008", words, line=fault.line or told.get("line"), traceback=fault.traceback)

    def _judge_installed(self, subject: Subject, loaded: Loaded) -> Iterator[Finding]:
        """Of an installed package only what keeps an environment from being made: how it is written is its own."""
        fault, told, name = loaded.trace.fault, loaded.description, subject.target.path
        if fault is not None:
            ask_for_dependency(subject, fault)
        if loaded.end.how is not How.DONE:
            yield self._broken(loaded)
        elif fault is not None and _absent(fault, name):
            # What was misspelt is there under another name.
            advice = "" if "did you mean" in fault.message else _put_there(subject)
            raise WorkerLost(f"{fault.message}{advice}")
        elif fault is not None and fault.type.endswith("NoSuchEnvironment"):
            yield self.finding("EC005", fault.message)
        elif fault is not None and fault.phase == "import":
            yield self.finding("EC003", f"importing raises {fault}", line=fault.line, traceback=fault.traceback)
        elif told.get("required"):
            yield self._needs(name, told)
        elif told.get("environment") is False:
            words = f"{name} makes a {told.get('made')}, which does not derive from gymnasium.Env"
            yield self.finding("EC005", words, line=told.get("line"))
        elif fault is not None:
            line = fault.line or told.get("line")
            yield self.finding("EC008", f"making {name} raises {fault}", line=line, traceback=fault.traceback)

    def _needs(self, name: str | None, told: Description) -> Finding:
        needed = ", ".join(told["required"])
        return self.finding("EC007", f"{name}() needs {needed}", line=told.get("line"), required=told["required"])

    def _broken(self, loaded: Loaded) -> Finding:
        end = loaded.end
        where = "the constructor" if end.phase == "construct" else "importing the file"
        if end.how is How.TIMEOUT:
            code = "EC008" if end.phase == "construct" else "EC004"
            return self.finding(code, f"{where} did not end: {end.detail}", output=end.output[-2000:])
        code = "EC008" if end.phase == "construct" else "EC003"
        return self.finding(code, f"{where} ended the process ({end.how}: {end.detail})", output=end.output[-2000:])

    def _judge_effects(self, effects: Effects, output: str) -> Iterator[Finding]:
        found = []
        if output.strip():
            found.append(f"prints {output.strip().splitlines()[0][:60]!r}")
        if effects.get("random") or effects.get("numpy_random"):
            found.append("changes the global random generators")
        if (threads := effects.get("threads", 0)) > 0:
            found.append(f"starts {threads} threads")
        seconds = effects.get("seconds", 0.0)
        if seconds > _SLOW_IMPORT:
            found.append(f"takes {seconds:.1f} s")
        if found:
            yield self.finding("EC009", f"loading the file {' and '.join(found)}", **effects)

    def _wrong_count(self, classes: list[str], told: Description) -> Finding:
        if classes:
            return self.finding(
                "EC006", f"the file defines {len(classes)} environments: {', '.join(classes)}", classes=classes
            )
        alike = ", ".join(told.get("lookalikes", []))
        hint = f"; {alike} has reset and step but does not derive from gymnasium.Env" if alike else ""
        return self.finding("EC005", f"no concrete subclass of gymnasium.Env with reset and step{hint}")


def required_imports(tree: ast.AST, unknown: Collection[str] = (), python: tuple[int, ...] = ()) -> dict[str, int]:
    """The top-level modules that the code cannot do without, each with the line of its first import.

    `unknown` are those that cannot be imported; `python` is the version that runs the code, if it is known.
    """
    found: dict[str, int] = {}
    flags = _flags(tree) | {"find_spec"}
    mentioned: set[str] = set()
    uncalled: dict[str, list[tuple[ast.AST, bool]]] = {}
    pending: list[tuple[ast.AST, bool]] = [(tree, True)]
    while pending:
        node, required = pending.pop()
        optional: list[ast.AST] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not _is_called(node, mentioned):
            uncalled.setdefault(node.name, []).append((node, required))
            parts: list[ast.AST] = [node.args]
        elif isinstance(node, ast.Try) and any(_catches(handler.type) for handler in node.handlers):
            lacking = any(name in unknown for part in node.body for one in ast.walk(part) for name in _modules(one))
            parts = [*(node.handlers if lacking else node.orelse), *node.finalbody]
            optional = [*node.body, *(node.orelse if lacking else node.handlers)]
        elif isinstance(node, ast.With) and any(_suppresses(item.context_expr) for item in node.items):
            parts, optional = [*node.items], [*node.body]
        elif isinstance(node, ast.If) and _names(node.test) & {"TYPE_CHECKING", "__name__"}:
            parts = [*node.orelse]
        elif isinstance(node, ast.If) and "version_info" in _names(node.test):
            runs = _holds(node.test, python)
            parts = [] if runs is None else [*(node.body if runs else node.orelse)]
            optional = [*node.body, *node.orelse] if runs is None else []
        elif isinstance(node, ast.If) and _names(node.test) & flags:
            parts, optional = [node.test], [*node.body, *node.orelse]
        else:
            parts = [*ast.iter_child_nodes(node)]
            for name in _modules(node) if required else []:
                line: int = getattr(node, "lineno", 1)
                found[name] = min(found.get(name, line), line)
        if isinstance(node, ast.Name | ast.Attribute):
            name = node.id if isinstance(node, ast.Name) else node.attr
            mentioned.add(name)
            pending += uncalled.pop(name, [])
        pending += [(part, required) for part in parts] + [(part, False) for part in optional]
    return found


def _modules(node: ast.AST) -> list[str]:
    """The top-level modules that a statement imports; a relative import's name as it is written."""
    if isinstance(node, ast.Import):
        return [alias.name.partition(".")[0] for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        module = node.module or ""
        return ["." * node.level + module if node.level else module.partition(".")[0]]
    return []


def _is_called(function: ast.FunctionDef | ast.AsyncFunctionDef, mentioned: set[str]) -> bool:
    """Whether a function may run: something that does mentions it, a decorator knows it, or Gymnasium does."""
    name = function.name
    return name in mentioned | _CALLED or name.startswith("__") or bool(function.decorator_list)


def _flags(tree: ast.AST) -> set[str]:
    """The names that tell whether a library is there: what find_spec() said, or set where an import may fail."""
    told: list[ast.Assign] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and "find_spec" in _names(node.value):
            told.append(node)
        elif isinstance(node, ast.Try) and any(_catches(handler.type) for handler in node.handlers):
            blocks = [node.body, node.orelse, *(handler.body for handler in node.handlers)]
            lines = (line for block in blocks for line in block)
            told += [line for line in lines if isinstance(line, ast.Assign) and isinstance(line.value, ast.Constant)]
    return {target.id for assigned in told for target in assigned.targets if isinstance(target, ast.Name)}


def _absent(fault: Fault, name: str) -> bool:
    """Whether what the target names is not installed at all: the mistake of whoever asks, or of the worker's maker."""
    if fault.phase == "import" and fault.type == "ModuleNotFoundError":
        module = name.partition(":")[0]
        parents = [module.rsplit(".", number)[0] for number in range(module.count(".") + 1)]
        return any(fault.message == f"No module named {parent!r}" for parent in parents)
    return fault.type.endswith("NoSuchEnvironment") and fault.message.startswith("no installed package")


def ask_for_dependency(subject: Subject, fault: Fault) -> None:
    """Raise WorkerLost where an installed package says that a library which it can do without elsewhere is missing."""
    from envcraft.target import Kind

    if subject.target.kind is not Kind.SOURCE and fault.type == "gymnasium.error.DependencyNotInstalled":
        raise WorkerLost(f"{fault.message.rstrip('. ')}{_put_there(subject)}")


def _put_there(subject: Subject) -> str:
    """What to do about a package that the worker lacks."""
    if subject.driver.isolation is Isolation.CONTAINER:
        return "; the image must hold the package: `envcraft sandbox build --packages FILE`, or use another --sandbox"
    return "; install the package beside EnvCraft, then judge again"


def is_standard(name: str) -> bool:
    import sys

    return name in sys.stdlib_module_names


def _catches(caught: ast.expr | None) -> bool:
    """Whether what a handler catches may be an ImportError."""
    if caught is None:
        return True
    return bool(_names(caught) & {"ImportError", "ModuleNotFoundError", "Exception", "BaseException"})


def _suppresses(context: ast.expr) -> bool:
    if not isinstance(context, ast.Call) or "suppress" not in _names(context.func):
        return False
    return any(map(_catches, context.args))


def _holds(test: ast.expr, python: tuple[int, ...]) -> bool | None:
    """Whether a comparison of sys.version_info holds; None where that is not known."""
    if not python or not isinstance(test, ast.Compare) or not isinstance(test.left, ast.Name | ast.Attribute):
        return None
    order = _ORDERS.get(type(test.ops[0]))
    try:
        return None if order is None or test.ops[1:] else order(python, ast.literal_eval(test.comparators[0]))
    except (ValueError, TypeError):
        return None


def _names(expression: ast.expr) -> set[str]:
    names = {node.id for node in ast.walk(expression) if isinstance(node, ast.Name)}
    return names | {node.attr for node in ast.walk(expression) if isinstance(node, ast.Attribute)}


def _nearest(name: str, known: list[str]) -> str | None:
    if name in _OLD_NAMES:
        return _OLD_NAMES[name]
    # Slow to import, and most imports are known.
    import difflib

    close = difflib.get_close_matches(name, known, n=1, cutoff=0.75)
    return close[0] if close else None


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Source()]
