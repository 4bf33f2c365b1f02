"""The source of a class that was defined in a script, a notebook or an interactive interpreter.

Only the statements that the class needs are kept: its definition, the imports, and the functions and values that it
names, directly or not. They stay in their lines, so that findings name lines of the script, or of a cell.
"""

from __future__ import annotations

import ast
import builtins
import dis
import inspect
import itertools
import linecache
import sys
import warnings
from types import CodeType, FunctionType

from envcraft.errors import UsageError
from envcraft.model.target import Target, parse

#: The names of the cells of a notebook in Python's cache of lines.
_CELLS = ("<ipython-input-", "<stdin>-", "<python-input-")
#: The instructions that read and bind a name that is not a function's own.
_READS = {"LOAD_NAME", "LOAD_GLOBAL", "LOAD_FROM_DICT_OR_GLOBALS"}
_BINDS = {"STORE_NAME", "STORE_GLOBAL"}
_DEFINITIONS = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def target_of(kind: type) -> Target:
    """The target that has the source of a class and of what it needs.

    Args:
        kind: a class that is defined at the top level of a module, a script or a notebook.

    Raises:
        UsageError: the source is not known, or lacks a name that the class needs.
    """
    if "<locals>" in kind.__qualname__ or "." in kind.__qualname__:
        raise UsageError(f"{kind.__qualname__} is defined inside a function or a class; define it at the top level")
    file = _file(kind)
    in_cells = file.startswith("<") or "ipykernel" in file
    texts = _cells(file) if in_cells else {file: "".join(linecache.getlines(file))}
    if not any(texts.values()):
        raise UsageError(f"the source of {kind.__name__} is not known; save it in a file, and validate the file")
    known = vars(sys.modules.get(kind.__module__, builtins))
    source = needed("\n".join(texts.values()), kind.__name__, frozenset(known)).encode()
    if not in_cells:
        return Target(file, source, kind.__name__)
    lengths = [len(text.splitlines()) for text in texts.values()]
    firsts = itertools.accumulate(lengths, initial=1)
    return Target(f"{kind.__name__} (notebook).py", source, kind.__name__, cells=dict(zip(texts, firsts, strict=False)))


def needed(text: str, name: str, known: frozenset[str] = frozenset()) -> str:
    """Keep the statements of a module that a name of it needs, each in its line, and leave other lines empty.

    Args:
        text: the module.
        name: a name that it binds at its top level.
        known: the names that the module has when it runs.

    Returns:
        The module's text with as many lines.

    Raises:
        UsageError: nothing binds the name, or one that it needs.
    """
    try:
        body = [_Statement(node) for node in parse(text).body]
    except SyntaxError as error:
        raise UsageError(f"the source of {name} cannot be parsed: {error.msg} (line {error.lineno})") from None
    if not _binders(body, name, len(body)):
        words = f"no statement of its module binds the class {name} outside functions and `if __name__`"
        raise UsageError(f"{words}; define it at the top level as {name}")
    kept: set[int] = set()
    unbound: set[str] = set()
    # A name as of a statement: a class body reads what is bound above it, its methods read what is bound in the end.
    pending = [(name, len(body))]
    seen: set[tuple[str, int]] = set()
    while pending:
        wanted, place = pending.pop()
        if (wanted, place) in seen:
            continue
        seen.add((wanted, place))
        found = _binders(body, wanted, place)
        if not found and not hasattr(builtins, wanted):
            found = _binders(body, wanted, len(body))
            if not found:
                unbound.add(wanted)
        for index in found:
            kept.add(index)
            pending += [(each, index) for each in body[index].reads]
            # A function may run already while the module is imported.
            pending += [(each, when) for each in body[index].reads_later for when in (place, len(body))]
    unbound = {each for each in unbound & known if not each.startswith("__")}
    if unbound:
        stars = {index for index, each in enumerate(body) if each.is_star}
        unbound -= {each for index in kept for each in body[index].binds_later}
        if unbound and not stars:
            words = f"{name} needs {min(unbound)}, and no statement of its module binds it outside functions and"
            raise UsageError(f"{words} `if __name__`; bind it at the top level, or pass it")
        kept |= stars
    # Annotations are evaluated lazily only as long as this import is there.
    futures = [each.node for each in body if isinstance(each.node, ast.ImportFrom) and each.node.module == "__future__"]
    names = {wanted for wanted, _ in seen}
    lines = text.splitlines()
    shown: dict[int, str] = {}
    for node in [*(body[index].node for index in sorted(kept)), *futures]:
        decorated = [decorator.lineno for decorator in getattr(node, "decorator_list", ())]
        numbers = range(min([node.lineno, *decorated]), (node.end_lineno or node.lineno) + 1)
        fewer = None if node in futures else _import_of(node, names)
        if fewer is None:
            shown.update((number, lines[number - 1]) for number in numbers)
        else:
            for number in numbers:
                shown.setdefault(number, fewer if number == node.lineno else "")
    return "\n".join(shown.get(number, "") for number in range(1, len(lines) + 1)) + "\n"


def _import_of(node: ast.stmt, names: set[str]) -> str | None:
    """An import statement that imports only some of its names; None for another statement, or if it imports no more."""
    if not isinstance(node, ast.Import | ast.ImportFrom):
        return None
    aliases = [alias for alias in node.names if (alias.asname or alias.name.partition(".")[0]) in {"*", *names}]
    if len(aliases) == len(node.names):
        return None
    fewer = ast.Import(aliases) if isinstance(node, ast.Import) else ast.ImportFrom(node.module, aliases, node.level)
    return ast.unparse(fewer)


class _Statement:
    """The global names that a statement at the top level binds and reads; its bytecode has no other names.

    Attributes:
        node: the statement.
        binds: the names that it binds when it runs.
        changes: the names to whose items or attributes it assigns.
        reads: the names that it reads when it runs.
        reads_later: the names that its functions read.
        binds_later: the names that its functions bind.
    """

    def __init__(self, node: ast.stmt) -> None:
        """Raises SyntaxError."""
        self.node = node
        self.binds: set[str] = set()
        self.changes: set[str] = set()
        self.reads: set[str] = set()
        self.reads_later: set[str] = set()
        self.binds_later: set[str] = set()
        # Notebooks await in cells.
        flags = ast.PyCF_ALLOW_TOP_LEVEL_AWAIT
        with warnings.catch_warnings():
            # Python has shown the warnings of the script already.
            warnings.simplefilter("ignore")
            code = compile(ast.Module([node], []), "", "exec", flags, dont_inherit=True, optimize=0)
        self._read(code, runs=True)
        if isinstance(node, ast.If) and "__name__" in ast.dump(node.test):
            # An importer does not run it.
            return
        self.binds = {each.argval for each in dis.get_instructions(code) if each.opname in _BINDS}
        for target in getattr(node, "targets", [getattr(node, "target", None)]):
            while isinstance(target, ast.Attribute | ast.Subscript):
                target = target.value
                if isinstance(target, ast.Name):
                    self.changes.add(target.id)

    @property
    def replaces(self) -> bool:
        """Whether it binds its names in any case, so that earlier statements do not matter."""
        return isinstance(self.node, _DEFINITIONS) or not {"body", "cases"} & {*self.node._fields}

    @property
    def is_star(self) -> bool:
        """Whether it imports names that it does not list."""
        return isinstance(self.node, ast.ImportFrom) and self.node.names[0].name == "*"

    def _read(self, code: CodeType, runs: bool) -> None:
        own: set[str] = set()
        for each in dis.get_instructions(code):
            if each.opname in _READS and each.argval not in own:
                (self.reads if runs else self.reads_later).add(each.argval)
            elif each.opname == "STORE_NAME":
                own.add(each.argval)
            elif each.opname == "STORE_GLOBAL":
                self.binds_later.add(each.argval)
        for inner in code.co_consts:
            if isinstance(inner, CodeType):
                # Comprehensions and lists of type parameters run at once, as class bodies do.
                at_once = inner.co_name.startswith("<") and inner.co_name != "<lambda>"
                self._read(inner, runs and (at_once or not inner.co_flags & inspect.CO_OPTIMIZED))


def _binders(body: list[_Statement], name: str, end: int) -> list[int]:
    """The places of the statements before a place that give a name its value there."""
    found = []
    for index in reversed(range(end)):
        if name in body[index].binds or name in body[index].changes:
            found.append(index)
            if name in body[index].binds and body[index].replaces:
                break
    return found


def _file(kind: type) -> str:
    """The file, or the cell of a notebook, that defines a class."""
    for value in vars(kind).values():
        function = inspect.unwrap(value) if callable(value) else None
        if isinstance(function, FunctionType) and function.__module__ == kind.__module__:
            return function.__code__.co_filename
    return str(getattr(sys.modules.get(kind.__module__), "__file__", None) or "")


def _cells(file: str) -> dict[str, str]:
    """The cells of a session by name, in the order in which they ran; magic commands are left out."""
    history = getattr(sys.modules.get("__main__"), "In", None)
    if isinstance(history, list):
        texts = {f"In [{number}]": str(cell) for number, cell in enumerate(history)}
    else:
        named = [name for name in list(linecache.cache) if name.startswith(_CELLS)]
        texts = {name: "".join(linecache.getlines(name)) for name in named or [file]}
    cells = {name: _without_magic(text) for name, text in texts.items()}
    return {name: text for name, text in cells.items() if text.strip()}


def _without_magic(text: str) -> str:
    """A cell without the lines that only IPython understands; "" if it is no Python then."""
    lines = ["" if line.startswith(("%", "!")) else line for line in text.splitlines()]
    text = "\n".join(lines)
    try:
        parse(text)
    except (SyntaxError, ValueError):
        return ""
    return text
