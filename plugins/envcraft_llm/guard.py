"""Whether a repair guts the game: passes the checks by being less than what the brief asks for and was there before.

A repair is held against the attempt that it repairs and against the first one, so that a game cannot be taken apart in
small steps. Compared are the source (its size, the ways to end, to win and to be paid, the parts of the action and the
numbers of the brief that it names) and what it does under the same scripted play. What was broken before is no measure:
an attempt that does not parse, or could not be played, is left out of what it cannot show.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.reports import plural
from envcraft.stages import Attempt
from envcraft.target import parse

from .findings import findings

if TYPE_CHECKING:
    from envcraft.subject import Subject

#: A repair has at least this share of what the attempt before had, and of what the first one had.
_BEFORE, _FIRST = 0.65, 0.5
#: Of different frames a step, of different rewards and of moves that matter, this share at least stays.
_PLAY = 0.5
#: Fewer than so many statements, numbers, or steps of play say nothing.
_FEW_STATEMENTS, _FEW_NUMBERS, _FEW_STEPS = 25, 6, 20
_MANY_REWARDS = 4
#: No parameter of a game, and no float either.
_HUGE = 1e12
_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]*\w)")
_PAID = re.compile(r"reward|score|bonus|penalt|payoff", re.IGNORECASE)
_WON = re.compile(r"is_success|won|win|victory|success|solved|escaped|complete", re.IGNORECASE)
_RANDOM = re.compile(r"random|rng", re.IGNORECASE)
_LOST = re.compile(r"terminated|game_over|done|dead|lost|lives|health|hp", re.IGNORECASE)


class Shape(msgspec.Struct, frozen=True):
    """What a source is made of.

    Attributes:
        statements: how many it has.
        methods: the functions of its classes.
        paid: statements that set a reward or a score.
        wins, losses: assignments of what tells that it was won, or is over.
        drawn: whether random numbers are drawn, from whatever generator.
        parts: the indices of the action that are read.
        numbers: all numbers that differ.
    """

    statements: int
    methods: int
    paid: int
    wins: int
    losses: int
    drawn: bool
    parts: frozenset[int]
    numbers: frozenset[float]


def profile(subject: Subject) -> dict[str, Any]:
    """What an environment does in the episodes that every attempt is played with, in numbers; {} where none could be
    stepped.
    """
    traces = [trace for trace in subject.traces if trace.steps and not trace.rollout.conditions.to_json()]
    if not traces:
        return {}
    by_seed: dict[int, set[bytes]] = {}
    for trace in traces:
        actions = trace.rollout.actions
        if len(actions) > 1 and all(action == actions[0] for action in actions):
            by_seed.setdefault(trace.rollout.seed, set()).add(b"".join(trace.observations[: _FEW_STEPS + 1]))
    return {
        "steps": sum(trace.steps for trace in traces),
        "frames": len({frame for trace in traces for frame in trace.observations}),
        "rewards": len({round(reward, 6) for trace in traces for reward in trace.rewards if reward}),
        "moves": max((len(ways) for ways in by_seed.values()), default=0),
        "longest": max(trace.steps for trace in traces),
    }


@lru_cache(maxsize=64)
def shape(source: str) -> Shape | None:
    """The shape of a source; None where it does not parse."""
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
    return Shape(
        statements=sum(isinstance(node, ast.stmt) for node in nodes),
        methods=sum(isinstance(node, ast.FunctionDef) for node in nodes),
        paid=_about(set_names, _PAID),
        wins=_about(set_names, _WON) + _keys(nodes, "is_success"),
        losses=_about(set_names, _LOST),
        drawn=any(
            _RANDOM.search(node.attr if isinstance(node, ast.Attribute) else node.id)
            for node in nodes
            if isinstance(node, ast.Attribute | ast.Name)
        ),
        parts=_parts(nodes),
        numbers=frozenset(_numbers(nodes)),
    )


def gutted(brief: str, first: Attempt, before: Attempt, repair: Attempt) -> str:
    """Why a repair is less than what it repairs, in one sentence; "" where it is not. `before` and `first` are attempts
    that are none themselves.
    """
    new = shape(repair.source)
    if new is None:
        # The checks say so.
        return ""
    for old, words, share in ((before, "the attempt before", _BEFORE), (first, "the first attempt", _FIRST)):
        known = shape(old.source)
        if known is None:
            if said := _shorter(old.source, repair.source, words, share):
                return said
            continue
        if said := next(filter(None, _less(brief, known, new, words, share)), ""):
            return said
    played = (before, "the attempt before"), (first, "the first attempt")
    return next(filter(None, (_does_less(old, repair, words) for old, words in played)), "")


def _shorter(old: str, new: str, words: str, share: float) -> str:
    lines, left = (sum(bool(line.strip()) for line in text.splitlines()) for text in (old, new))
    if lines >= _FEW_STATEMENTS and left < share * lines:
        return f"size: {_left(left, 'line')} of the {lines} of {words}"
    return ""


def _less(brief: str, old: Shape, new: Shape, words: str, share: float) -> Iterable[str]:
    """What of the source is gone."""
    if old.statements >= _FEW_STATEMENTS and new.statements < share * old.statements:
        yield f"size: {_left(new.statements, 'statement')} of the {old.statements} of {words}"
    if old.paid >= 2 and new.paid < share * old.paid:
        yield f"rewards: {_left(new.paid, 'statement')} of the {old.paid} by which {words} pays"
    if old.wins and not new.wins:
        yield f"winning: nothing sets that the game is won any more, as {words} does"
    if old.losses and not new.losses:
        yield f"ending: nothing ends the game any more, as {words} does"
    if old.drawn and not new.drawn:
        yield f"chance: no random number is drawn any more, as {words} does"
    # Where none shows, they are read in a way that does not.
    if gone := sorted(old.parts - new.parts) if new.parts else []:
        yield f"controls: the action's part {gone[0]} is not read any more, as {words} does"
    asked = {float(number) for number in _NUMBER.findall(brief)} - {0.0, 1.0, 2.0, 84.0, 255.0}
    had, has = asked & old.numbers, asked & new.numbers
    if len(had) >= _FEW_NUMBERS and len(has) < share * len(had):
        yield f"parameters: of the brief {_left(len(has), 'number')} of the {len(had)} in {words}"


def _left(number: int, noun: str) -> str:
    return f"{plural(number, noun)} {'is' if number == 1 else 'are'} left"


def _does_less(old: Attempt, new: Attempt, words: str) -> str:
    """What of the play is gone. Rates are compared, since a crash may have cut the play before short."""
    then, now = old.profile, new.profile
    if not then or not now or min(then["steps"], now["steps"]) < _FEW_STEPS:
        return ""
    rates = [found["frames"] / found["steps"] for found in (then, now)]
    noisy = any(finding.code == "EC402" for finding in findings(old.report))
    if rates[1] < _PLAY * rates[0] and now["frames"] < then["frames"] and not noisy:
        return (
            f"play: the same moves lead to {now['frames']:,} different frames in {now['steps']:,} steps, "
            f"and in {words} to {then['frames']:,} in {then['steps']:,}"
        )
    # Of many, most may have been the defect.
    if then["rewards"] >= 2 and now["rewards"] < _PLAY * min(then["rewards"], _MANY_REWARDS):
        return f"play: the same moves earn {now['rewards']} different rewards, and in {words} {then['rewards']}"
    if then["moves"] >= 3 and now["moves"] < _PLAY * then["moves"]:
        return f"play: {now['moves']} of the moves differ in what they do, and in {words} {then['moves']}"
    return ""


def _numbers(nodes: Iterable[ast.AST]) -> Iterator[float]:
    for node in nodes:
        value = node.value if isinstance(node, ast.Constant) else None
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _HUGE:
            yield float(value)


def _names(node: ast.Assign | ast.AugAssign | ast.AnnAssign) -> list[str]:
    """What a statement sets: the last names of its targets."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    parts = [part for target in targets for part in (target.elts if isinstance(target, ast.Tuple) else [target])]
    return [part.attr if isinstance(part, ast.Attribute) else getattr(part, "id", "") for part in parts]


def _about(set_names: list[list[str]], wanted: re.Pattern[str]) -> int:
    """How many statements set what is called so."""
    return sum(any(wanted.search(name) for name in names) for names in set_names)


def _is_plain_zero(node: ast.AST) -> bool:
    """Whether nothing is set but a start: 0, False or None."""
    value = getattr(node, "value", None)
    return isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(value, ast.Constant) and not value.value


def _keys(nodes: Iterable[ast.AST], name: str) -> int:
    """How often a text is written that is not but the name of what is always False."""
    found = 0
    for node in nodes:
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                told = isinstance(key, ast.Constant) and key.value == name
                found += told and not (isinstance(value, ast.Constant) and not value.value)
    return found


def _parts(nodes: Iterable[ast.AST]) -> frozenset[int]:
    """The indices by which something that is called an action is read; all three where it is taken apart as a whole."""
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
    """Whether something is called an action. What is nested too deeply to be written out is none."""
    try:
        return "act" in ast.unparse(node).lower()
    except RecursionError:
        return False


def _ignored(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id.startswith("_")
