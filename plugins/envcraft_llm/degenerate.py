"""Degenerate repairs: those that pass the checks by doing less than the brief requires and the file did before.

A repair is compared with the attempt that it repairs and with the first attempt, so that a game cannot be dismantled
in small steps. The comparison covers the source (its size, the statements that end, win and reward, the parts of the
action and the numbers of the brief that it uses) and its behaviour under the same scripted episodes. Attempts that do
not parse, or could not be played, are left out of the comparisons that need it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.generation.stages import Attempt
from envcraft.model.target import parse
from envcraft.text import plural

from .findings import findings

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject

#: Minimum share of the previous attempt and of the first attempt that a repair keeps.
_PREVIOUS_SHARE, _FIRST_SHARE = 0.65, 0.5
#: Minimum share of distinct frames per step, of distinct rewards and of effective moves that a repair keeps.
_PLAY_SHARE = 0.5
#: Minimum number of statements, numbers and steps for a comparison.
_MIN_STATEMENTS, _MIN_NUMBERS, _MIN_STEPS = 25, 6, 20
_MANY_REWARDS = 4
#: Numbers from this size on are no parameters of a game, and may exceed a float.
_MAX_NUMBER = 1e12
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]*\w)")
_PAID = re.compile(r"reward|score|bonus|penalt|payoff", re.IGNORECASE)
_WON = re.compile(r"is_success|won|win|victory|success|solved|escaped|complete", re.IGNORECASE)
_RANDOM = re.compile(r"random|rng", re.IGNORECASE)
_LOST = re.compile(r"terminated|game_over|done|dead|lost|lives|health|hp", re.IGNORECASE)


class Structure(msgspec.Struct, frozen=True):
    """Structure of a source.

    Attributes:
        statements: Number of statements.
        methods: Number of functions.
        rewards: Statements that set a reward or a score.
        wins: Assignments that report a win.
        losses: Assignments that report the end of the game.
        random: Whether it draws random numbers.
        parts: Indices of the action that it reads.
        numbers: Distinct numbers.
    """

    statements: int
    methods: int
    rewards: int
    wins: int
    losses: int
    random: bool
    parts: frozenset[int]
    numbers: frozenset[float]


def profile(subject: Subject) -> dict[str, Any]:
    """Return statistics of an environment's behaviour in the episodes that every attempt plays; {} without any step."""
    traces = [trace for trace in subject.traces if trace.steps and not trace.rollout.conditions.to_json()]
    if not traces:
        return {}
    by_seed: dict[int, set[bytes]] = {}
    for trace in traces:
        actions = trace.rollout.actions
        if len(actions) > 1 and all(action == actions[0] for action in actions):
            by_seed.setdefault(trace.rollout.seed, set()).add(b"".join(trace.observations[: _MIN_STEPS + 1]))
    return {
        "steps": sum(trace.steps for trace in traces),
        "frames": len({frame for trace in traces for frame in trace.observations}),
        "rewards": len({round(reward, 6) for trace in traces for reward in trace.rewards if reward}),
        "moves": max((len(ways) for ways in by_seed.values()), default=0),
        "longest": max(trace.steps for trace in traces),
    }


@lru_cache(maxsize=64)
def structure(source: str) -> Structure | None:
    """Return the structure of a source; None if it does not parse."""
    try:
        tree = parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    nodes = list(ast.walk(tree))
    set_names = [
        _names(node)
        for node in nodes
        if isinstance(node, (ast.Assign, ast.AugAssign, ast.AnnAssign)) and not _is_plain_zero(node)
    ]
    return Structure(
        statements=sum(isinstance(node, ast.stmt) for node in nodes),
        methods=sum(isinstance(node, ast.FunctionDef) for node in nodes),
        rewards=_assignments(set_names, _PAID),
        wins=_assignments(set_names, _WON) + _keys(nodes, "is_success"),
        losses=_assignments(set_names, _LOST),
        random=any(
            _RANDOM.search(node.attr if isinstance(node, ast.Attribute) else node.id)
            for node in nodes
            if isinstance(node, ast.Attribute | ast.Name)
        ),
        parts=_parts(nodes),
        numbers=frozenset(_numbers(nodes)),
    )


def degenerate_reason(brief: str, first: Attempt, before: Attempt, repair: Attempt) -> str:
    """Return why a repair is degenerate, in one sentence; "" if it is not.

    Args:
        brief: Design document of the game.
        first: The first attempt.
        before: The attempt that is repaired.
        repair: The repair.
    """
    new = structure(repair.source)
    if new is None:
        # The check ``source`` reports it.
        return ""
    named = (before, "the previous attempt"), (first, "the first attempt")
    for (old, words), share in zip(named, (_PREVIOUS_SHARE, _FIRST_SHARE), strict=True):
        known = structure(old.source)
        if known is None:
            if said := _shorter(old.source, repair.source, words, share):
                return said
            continue
        if said := next(filter(None, _less(brief, known, new, words, share)), ""):
            return said
    return next(filter(None, (_does_less(old, repair, words) for old, words in named)), "")


def _shorter(old: str, new: str, words: str, share: float) -> str:
    lines, left = (sum(bool(line.strip()) for line in text.splitlines()) for text in (old, new))
    if lines >= _MIN_STATEMENTS and left < share * lines:
        return f"size: {_left(left, 'line')} of the {lines} of {words}"
    return ""


def _less(brief: str, old: Structure, new: Structure, words: str, share: float) -> Iterable[str]:
    """Yield what the new source lacks."""
    if old.statements >= _MIN_STATEMENTS and new.statements < share * old.statements:
        yield f"size: {_left(new.statements, 'statement')} of the {old.statements} of {words}"
    if old.rewards >= 2 and new.rewards < share * old.rewards:
        yield f"rewards: {_left(new.rewards, 'statement')} of the {old.rewards} by which {words} pays"
    if old.wins and not new.wins:
        yield f"winning: the code no longer records a win, which {words} does"
    if old.losses and not new.losses:
        yield f"ending: the code no longer ends the game, which {words} does"
    if old.random and not new.random:
        yield f"chance: the code no longer draws random numbers, which {words} does"
    # Without any visible index, the action is read in a way that is not recognised.
    if gone := sorted(old.parts - new.parts) if new.parts else []:
        yield f"controls: the code no longer reads part {gone[0]} of the action, which {words} does"
    required = {float(number) for number in _NUMBER.findall(brief)} - {0.0, 1.0, 2.0, 84.0, 255.0}
    had, has = required & old.numbers, required & new.numbers
    if len(had) >= _MIN_NUMBERS and len(has) < share * len(had):
        yield f"parameters: {_left(len(has), 'number')} of the {len(had)} of the brief in {words}"


def _left(number: int, noun: str) -> str:
    return f"{plural(number, noun)} {'is' if number == 1 else 'are'} left"


def _does_less(old: Attempt, new: Attempt, words: str) -> str:
    """Return what the new behaviour lacks. Rates are compared, since a crash may have ended the old episodes early."""
    then, now = old.profile, new.profile
    if not then or not now or min(then["steps"], now["steps"]) < _MIN_STEPS:
        return ""
    rates = [found["frames"] / found["steps"] for found in (then, now)]
    noisy = any(finding.code == "EC402" for finding in findings(old.report))
    if rates[1] < _PLAY_SHARE * rates[0] and now["frames"] < then["frames"] and not noisy:
        return (
            f"play: the same moves lead to {now['frames']:,} different frames in {now['steps']:,} steps, "
            f"and in {words} to {then['frames']:,} in {then['steps']:,}"
        )
    # Many distinct rewards may have been the defect, so only a few are required.
    if then["rewards"] >= 2 and now["rewards"] < _PLAY_SHARE * min(then["rewards"], _MANY_REWARDS):
        return f"play: the same moves earn {now['rewards']} different rewards, and in {words} {then['rewards']}"
    if then["moves"] >= 3 and now["moves"] < _PLAY_SHARE * then["moves"]:
        return f"play: {now['moves']} of the moves differ in what they do, and in {words} {then['moves']}"
    return ""


def _numbers(nodes: Iterable[ast.AST]) -> Iterator[float]:
    for node in nodes:
        value = node.value if isinstance(node, ast.Constant) else None
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _MAX_NUMBER:
            yield float(value)


def _names(node: ast.Assign | ast.AugAssign | ast.AnnAssign) -> list[str]:
    """Return the last names of the targets of an assignment."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    parts = [part for target in targets for part in (target.elts if isinstance(target, ast.Tuple) else [target])]
    return [part.attr if isinstance(part, ast.Attribute) else getattr(part, "id", "") for part in parts]


def _assignments(set_names: list[list[str]], wanted: re.Pattern[str]) -> int:
    """Count the assignments whose target has a matching name."""
    return sum(any(wanted.search(name) for name in names) for names in set_names)


def _is_plain_zero(node: ast.AST) -> bool:
    """Whether a statement only initialises: it assigns 0, False or None."""
    value = getattr(node, "value", None)
    return isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(value, ast.Constant) and not value.value


def _keys(nodes: Iterable[ast.AST], name: str) -> int:
    """Count the dictionary entries with this key, except those whose value is a false constant."""
    found = 0
    for node in nodes:
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                matches = isinstance(key, ast.Constant) and key.value == name
                found += matches and not (isinstance(value, ast.Constant) and not value.value)
    return found


def _parts(nodes: Iterable[ast.AST]) -> frozenset[int]:
    """Return the indices of the action that the source reads: by subscript, slice or unpacking."""
    found: set[int] = set()
    for node in nodes:
        if isinstance(node, ast.Subscript) and _is_action(node.value):
            index = node.slice
            if isinstance(index, ast.Constant) and type(index.value) is int:
                found.add(index.value % 3)
            elif isinstance(index, ast.Slice):
                found.update(range(3))
        elif (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Tuple)
            and len(node.targets[0].elts) == 3
            and not isinstance(node.value, ast.Tuple)
            and _is_action(node.value)
        ):
            found.update(number for number, part in enumerate(node.targets[0].elts) if not _ignored(part))
    return frozenset(found)


def _is_action(node: ast.expr) -> bool:
    """Whether an expression names an action. An expression that is nested too deeply to unparse does not."""
    try:
        return "act" in ast.unparse(node).lower()
    except RecursionError:
        return False


def _ignored(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id.startswith("_")
