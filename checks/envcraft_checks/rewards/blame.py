"""Which of the lines that write the reward causes a finding, by the lines that ran in each call of an episode."""

from __future__ import annotations

import ast
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from envcraft.errors import Skip
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.target import Kind, parse
from envcraft_checks.linting.program import Program, line, name_of
from envcraft_checks.rewards.lines import RewardLines, Unknown, Walk, Write
from envcraft_checks.rewards.syntax import Scope, constant, returns

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.verdict import Finding

#: How many times more than any other line the one must pay that a sum is blamed on.
_DOMINATES = 2.0
#: The most calls of an episode that is played in place of the shortest one.
_LONGEST = 200
#: The share of the calls in which a line must run to raise the typical reward.
_OFTEN = 0.5
_MAKES_NAN = frozenset({
    "log", "log2", "log10", "log1p", "sqrt", "power", "divide", "true_divide", "reciprocal", "mean", "std", "var",
    "average", "median", "arccos", "arcsin", "acos", "asin", "arctanh",
})  # fmt: skip
_INFINITE = frozenset({"inf", "nan", "Inf", "NaN", "NAN", "Infinity", "NINF", "PINF"})
_NEVER_NEGATIVE = frozenset({"abs", "fabs", "square", "hypot", "norm"})


class Call(NamedTuple):
    """One call of ``step``: the lines of the file that it ran, and its reward."""

    ran: frozenset[int]
    reward: float


def blamed_line(subject: Subject, finding: Finding, episode: Rollout | None = None, bounded: bool = True) -> int | None:
    """Return the line that writes the reward that a finding is about.

    If several lines write it, the episode is played once more, and the lines that ran in its calls decide.

    Args:
        subject: the environment.
        finding: its reproduction shows the defect, at its last step unless its evidence says more.
        episode: a longer episode with the same defect at its last step. More calls without the defect come before.
        bounded: whether the episode takes only steps that the budget has left.

    Returns:
        The line; None if several lines may cause the finding, or if the tree does not tell.
    """
    lines = _read(subject.text, subject.class_statement) if subject.target.kind is Kind.SOURCE else None
    if lines is None:
        return None
    if finding.code == "EC306":
        return _only(_silent(lines, certain=bool(finding.evidence.get("certain"))))
    # A win may pay a zero that a line writes.
    zeros = finding.code == "EC305"
    alone = _alone(lines, deep=True, zeros=zeros)
    if alone is not None and not (finding.code == "EC301" and _made_elsewhere(lines)):
        return alone
    calls = _played(subject, finding, episode, bounded)
    found = Blame(lines, finding, subject.contract.reward_range, calls).line() if calls else None
    return found or _alone(lines, deep=False, zeros=zeros)


def reward_line(text: str, env_class: str | None) -> int | None:
    """Return the line that writes the reward that ``step`` of a class returns, if exactly one does.

    A line that writes a zero counts only if no other line writes the reward.

    Args:
        text: the source.
        env_class: the name of the class.

    Returns:
        The line; None if several lines write the reward, or if the tree does not tell.
    """
    lines = _read(text, env_class)
    return _alone(lines, deep=True) or _alone(lines, deep=False) if lines is not None else None


@lru_cache(maxsize=4)
def _read(text: str, env_class: str | None) -> RewardLines | None:
    if not env_class:
        return None
    try:
        return RewardLines(Program(parse(text), env_class))
    except (Unknown, SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def _alone(lines: RewardLines, deep: bool, zeros: bool = False) -> int | None:
    """The only line that writes the reward, of all calls; a zero only counts if nothing else does, or if `zeros`."""
    try:
        writes = lines.writes(deep=deep)
    except Unknown:
        return None
    return _only(write.line for write in (writes if zeros else _paying(writes)))


def _made_elsewhere(lines: RewardLines) -> bool:
    """Whether the lines that write the reward make no NaN, so that another line may."""
    return not any(_is_risky(write.value, write.scope, lines) for write in lines.writes())


def _silent(lines: RewardLines, certain: bool) -> set[int]:
    """The lines that write the reward, of which each writes a zero if that is certain; else those that could pay."""
    try:
        writes = lines.writes()
    except Unknown:
        return set()
    return {write.line for write in (writes if certain else _paying(writes))}


def _played(subject: Subject, finding: Finding, episode: Rollout | None, bounded: bool) -> list[Call]:
    """The calls of an episode, the last of which shows the defect; empty if they are not all known."""
    repro = finding.repro
    own = Rollout(repro.seed, repro.actions, Conditions.from_json(repro.conditions))
    # The worker describes the states of so many calls for certain.
    rollout = episode if episode is not None and len(episode.actions) <= _LONGEST else own
    steps = len(rollout.actions)
    if not steps or (bounded and not subject.affords(steps)):
        return []
    try:
        trace = subject.rollout(msgspec.structs.replace(rollout, player="these actions", fields=True))
    except Skip:
        return []
    states = trace.states[1:]
    calls = [Call(state.lines, reward) for state, reward in zip(states, trace.rewards, strict=False)]
    # Growth shows in any part of an episode.
    complete = len(calls) == steps or finding.code == "EC304"
    expected = finding.evidence.get("reward")
    return calls if complete and (expected is None or str(calls[-1].reward) == str(expected)) else []


def _only(places: Iterable[int]) -> int | None:
    found = set(places)
    return found.pop() if len(found) == 1 else None


def _paying(writes: list[Write]) -> list[Write]:
    """The places that write something else than a zero, if there are any."""
    return [write for write in writes if not write.is_zero] or writes


class Blame:
    """Chooses among the lines that write the reward.

    Args:
        lines: of the file.
        finding: what they are to explain.
        bounds: between which the contract wants each reward.
        calls: of the episode that shows the finding.
    """

    def __init__(self, lines: RewardLines, finding: Finding, bounds: tuple[float, float], calls: list[Call]) -> None:
        self._lines = lines
        self._finding = finding
        self._low, self._high = bounds
        self._calls = calls

    def line(self) -> int | None:
        """The line; None if the calls do not tell."""
        choose = {
            "EC301": self._not_finite,
            "EC302": self._no_number,
            "EC303": self._out_of_range,
            "EC304": self._growing,
            "EC305": self._unpaid,
        }.get(self._finding.code, self._paid)
        for deep in (True, False):
            try:
                if (found := choose(deep)) is not None:
                    return found
            except Unknown:
                continue
        return None

    @property
    def _last(self) -> Call:
        return self._calls[-1]

    def _writes(self, call: Call, deep: bool) -> list[Write]:
        return _paying(self._lines.writes(call.ran, deep))

    def _new(self, writes: list[Write]) -> set[int]:
        """The lines of some places that ran in no call before the last one."""
        before = frozenset().union(*(call.ran for call in self._calls[:-1]))
        return {write.line for write in writes if write.statement.lineno not in before}

    def _not_finite(self, deep: bool) -> int | None:
        # What cannot be NaN or infinite is not it.
        writes = [write for write in self._writes(self._last, deep) if write.limit is None]
        risky = risky_lines(writes, self._last.ran, self._lines)
        before = frozenset().union(*(call.ran for call in self._calls[:-1]))
        new = self._new(writes) if len(self._calls) > 1 else set()
        if len(risky) > 1 and len(risky - before) == 1:
            risky -= before
        if (found := _only(risky)) is not None:
            return found if not new - risky or found not in before else None
        return _only({write.line for write in writes}) or (_only(new) if not risky else None)

    def _no_number(self, deep: bool) -> int | None:
        kind = str(self._finding.evidence.get("kind", ""))
        writes = [write for write in self._lines.writes(self._last.ran, deep) if write.limit is None]
        fitting = [write for write in writes if _has_type(write, kind, self._lines)]
        return _only({write.line for write in fitting or writes}) or _only(self._new(writes))

    def _out_of_range(self, deep: bool) -> int | None:
        call = self._last
        writes = self._writes(call, deep)
        if (found := _only({write.line for write in writes})) is not None:
            return found
        shares = self._shares(call, deep)
        if shares is None:
            # Without all that has a limit the reward is outside, too.
            limit = sum(write.limit for write in writes if write.limit is not None and write.once)
            far = call.reward - limit > self._high or call.reward + limit < self._low
            open_ = [write for write in writes if write.limit is None or not write.once] if far else writes
            return _only({write.line for write in open_}) or _only(self._new(open_))
        causes = {number for number, share in shares.items() if self._fits(call.reward - share)}
        return _only(causes) or _only(causes & self._new(writes))

    def _fits(self, reward: float) -> bool:
        return self._low <= reward <= self._high

    def _growing(self, deep: bool) -> int | None:
        late = self._calls[len(self._calls) // 2 :]
        found: Counter[int] = Counter()
        for call in late:
            found.update({write.line for write in self._writes(call, deep) if write.limit is None or not write.once})
        often = {number for number, count in found.items() if count >= _OFTEN * len(late)}
        return _only(often) or _only(self._dominant(late, deep, size=True))

    def _unpaid(self, deep: bool) -> int | None:
        writes = self._lines.writes(self._last.ran, deep)
        return _only({write.line for write in writes}) or _only(self._new(writes))

    def _paid(self, deep: bool) -> int | None:
        calls = self._calls
        if self._finding.code == "EC307":
            calls = calls[-len(self._finding.evidence["loop"]) :]
        paying = [call for call in calls if call.reward > 0]
        places = {write.line for call in paying for write in self._writes(call, deep) if (write.amount or 1.0) > 0}
        return _only(places) or _only(self._dominant(paying, deep))

    def _dominant(self, calls: list[Call], deep: bool, size: bool = False) -> set[int]:
        """The line that pays much more than any other in some calls, by size if `size`."""
        totals: defaultdict[int, float] = defaultdict(float)
        for call in calls:
            if (shares := self._shares(call, deep)) is None:
                return set()
            for number, share in shares.items():
                totals[number] += abs(share) if size else share
        ranked = sorted(totals.items(), key=lambda pair: pair[1], reverse=True)
        if not ranked or ranked[0][1] <= 0:
            return set()
        clear = len(ranked) == 1 or ranked[0][1] >= _DOMINATES * ranked[1][1]
        return {ranked[0][0]} if clear else set()

    def _shares(self, call: Call, deep: bool) -> dict[int, float] | None:
        """What each line adds to the reward of a call; None if the file does not say so for all but one."""
        writes = self._writes(call, deep)
        if len({write.line for write in writes}) == 1:
            return {writes[0].line: call.reward}
        known: defaultdict[int, float] = defaultdict(float)
        unknown = [write for write in writes if write.amount is None or not write.once]
        for write in writes:
            if write.amount is not None and write.once:
                known[write.line] += write.amount
        shares: dict[int, float] = dict(known)
        rest = call.reward - sum(shares.values())
        if len({write.line for write in unknown}) > 1 or (unknown and not unknown[0].once):
            return None
        if not unknown:
            return shares if math.isclose(rest, 0.0, abs_tol=1e-6) else None
        shares[unknown[0].line] = shares.get(unknown[0].line, 0.0) + rest
        return shares


def _has_type(write: Write, kind: str, lines: RewardLines) -> bool:
    """Whether an expression looks like one that gives a value of this type."""
    value = write.value
    match kind:
        case "None":
            # A call of a function that returns nothing, or a None.
            returns_none = isinstance(value, ast.Constant) and value.value is None
            return returns_none or Walk(lines.program, None, True).called(value, write.scope) is not None
        case "bool":
            return isinstance(value, ast.Compare | ast.BoolOp) or (
                isinstance(value, ast.UnaryOp) and isinstance(value.op, ast.Not)
            )
        case "str":
            text = isinstance(value, ast.Constant) and isinstance(value.value, str)
            return text or isinstance(value, ast.JoinedStr)
    return False


def risky_lines(writes: list[Write], ran: frozenset[int], lines: RewardLines) -> set[int]:
    """The lines that ran, lead to some places, and may make a NaN or an infinity of ordinary numbers.

    Args:
        writes: the places.
        ran: the lines that ran.
        lines: of the file.
    """
    walk = Walk(lines.program, ran, True)
    found: set[int] = set()
    seen: set[int] = set()
    waiting: list[tuple[ast.expr, ast.stmt, Scope]] = [(one.value, one.statement, one.scope) for one in writes]
    while waiting:
        value, statement, scope = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        divides = isinstance(statement, ast.AugAssign) and isinstance(statement.op, ast.Div)
        if _is_risky(value, scope, lines) or (divides and not _is_guarded(value, scope, lines)):
            found.add(line(statement))
        waiting += _behind(value, statement, scope, walk)
    return found


def _behind(
    value: ast.expr, statement: ast.stmt, scope: Scope, walk: Walk
) -> Iterator[tuple[ast.expr, ast.stmt, Scope]]:
    """The values of this call that an expression is made of."""
    for node in ast.walk(value):
        if isinstance(node, ast.Name) and node.id in scope.function.local:
            if node.id in scope.arguments:
                yield scope.arguments[node.id]
                continue
            try:
                bound = walk.reaching(walk.bindings(node.id, scope), statement, scope)
            except Unknown:
                continue
            yield from ((one.value, one.statement, scope) for one in bound)
        elif isinstance(node, ast.Attribute) and scope.function.field(node):
            for function, one in walk.field_bindings(node, scope):
                yield one.value, one.statement, scope if function is scope.function else Scope(function)
        elif isinstance(node, ast.Call) and (called := walk.called(node, scope)) is not None:
            inner = walk.scope(called, node, statement, scope)
            yield from ((one.value, one, inner) for one in returns(called) if one.value is not None and walk.ran(one))


def _is_risky(value: ast.expr, scope: Scope, lines: RewardLines) -> bool:
    """Whether an expression divides, takes a logarithm or names an infinity, and nothing in it prevents the worst."""
    for node in ast.walk(value):
        match node:
            case ast.BinOp(op=ast.Div() | ast.FloorDiv() | ast.Mod(), right=part):
                if not _is_guarded(part, scope, lines):
                    return True
            case ast.BinOp(op=ast.Pow(), right=part):
                exponent = constant(part, scope, lines.program)
                if exponent is None or exponent < 0 or exponent != int(exponent):
                    return True
            case ast.Call(func=ast.Attribute() as func, args=[part, *_]) if func.attr in _MAKES_NAN:
                # The method of an array has no argument, and the root of a square is safe.
                if not _is_guarded(part, scope, lines):
                    return True
            case ast.Call(func=ast.Attribute(attr="mean" | "std" | "var"), args=[]):
                return True
            case ast.Call(func=ast.Name(id="float"), args=[ast.Constant(value=str())]):
                return True
            case ast.Attribute(attr=name, value=ast.Name(id="np" | "numpy" | "math")) if name in _INFINITE:
                return True
    return False


def _is_guarded(value: ast.expr, scope: Scope, lines: RewardLines) -> bool:
    """Whether what divides is never zero, as far as the tree tells."""
    known = constant(value, scope, lines.program)
    if known is not None:
        return known != 0
    text = ast.unparse(value)
    if any(text in ast.unparse(test) for test in _tests(value, scope, lines)):
        return True
    parents = lines.program.parents
    match value:
        case ast.Call(func=func, args=args) if name_of(func) in ("max", "maximum", "clip", "float", "int", "float64"):
            if len(args) == 1:
                return _is_guarded(args[0], scope, lines)
            return any((constant(one, scope, lines.program) or 0.0) > 0 for one in args)
        case ast.Call(func=func) if name_of(func) in _NEVER_NEGATIVE:
            around = parents.get(value)
            return isinstance(around, ast.Call) and name_of(around.func) == "sqrt"
        case ast.BinOp(left=one, op=ast.Add(), right=other):
            squares = all(_is_square(part) for part in (one, other))
            root_of = isinstance(parents.get(value), ast.Call)
            positive = any((constant(part, scope, lines.program) or 0.0) > 0 for part in (one, other))
            return positive or (squares and root_of)
        case ast.BoolOp(op=ast.Or(), values=parts):
            return bool(constant(parts[-1], scope, lines.program))
    return False


def _tests(value: ast.expr, scope: Scope, lines: RewardLines) -> Iterator[ast.expr]:
    """The conditions under which an expression is evaluated."""
    node: ast.AST = value
    while node in lines.program.parents and node is not scope.function.node:
        parent = lines.program.parents[node]
        if isinstance(parent, ast.If | ast.IfExp | ast.While) and node is not parent.test:
            yield parent.test
        node = parent


def _is_square(value: ast.expr) -> bool:
    match value:
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=2)):
            return True
        case ast.BinOp(left=one, op=ast.Mult(), right=other):
            return ast.dump(one) == ast.dump(other)
        case ast.BinOp(left=one, op=ast.Add(), right=other):
            return _is_square(one) and _is_square(other)
    return False
