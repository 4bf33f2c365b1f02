"""# lint

## What it does
Reads the syntax tree of a file: which functions `reset()`, `step()` and the constructor may call, and where values go
in them. It runs nothing, so it also judges lines that no play has reached. What is certain from the code is an error;
what is only suspicious is a warning, or off by default.

If nothing changes a value between two reads, their difference is zero. A reward or a test that uses it is an error.

Sums that a test of the end compares with `==` are computed in floats and in exact fractions. If no float equals the
number, EC056 is an error; if only the order of the additions decides, it is a warning. The same holds for whole numbers
that a count may skip, such as hearts that an enemy takes in twos.

EC059 also reports

- a step limit in digits that differs from the limit which the code declares and uses elsewhere,
- a reward that step() keeps for the next step, although the episode ends in this one,
- `all(a == b for a, b in zip(...))` of a list that may be empty,
- a use of an action under a test that is never true,
- a test of an area that starts at -1, because such a slice is empty,
- a reason for the end that never makes terminated true, and
- a set of drawn places if success needs all of them, because two places may be the same.

EC061 reports swapped flags, an info that is not a dict, and an info without the key for success that the info of
another end has. EC062 reports progress with a negative reward, a step of success that pays 0, and a prize that is
negative for a late success. EC063 reports an attribute that render() updates and step() reads, and a render() that
draws from self.np_random. EC064 reports a uint8 picture that becomes a float picture. EC065 is about what each step
pays, or each step with a button held, if that is more than success pays. EC066 is about a flag that only reset()
clears: where it is true, the picture shows nothing new. EC067 is about a list that is written out and a counter that
reads its items: no test and no limit keeps the counter below the length. EC068 reports a number that has the name of a
cost and increases the reward. EC069 is about arrays of unsigned integers: distances between them, and colours that pass
255. EC070 is about pixels of a pygame surface that nothing transposes. EC071 is about a reward such as
`2 ** self.streak`, if nothing limits the streak; where the power grows slowly, it is a warning.

EC076 and EC077 are about lines that raise when play comes to them: a name that nothing defines, and arguments that a
function does not take. EC078 is about a statement that drops its result, such as `np.clip(self.x, 0, 80)`, and EC079
about a squared distance beside a radius. EC080 is about tables that a level reads: if the test before `level += 1` lets
it reach 3, a table of three items is too short.

The check runs after the others. If play has shown a defect of the same kind, for example EC204 for a draw from a global
generator, that finding has the reproduction, and this check does not repeat it. A rule that is off by default reports
only if `--select` names its code, or if its code has a severity.

Only branches under `if self.render_mode == "human"` and functions that nothing calls are left out. The check accepts a
generator made from `self.np_random` or from the seed, a constant seed for one level that only `reset()` draws, the
clock for a frame rate or telemetry in info, sets that are sorted or only tested for membership, class attributes and
globals that nothing writes, a table that only caches results, and a copy of a buffer. Sets of numbers, or of tuples of
numbers, have the same order in each process.

## Why is this bad?
Play reaches what random actions and searches reach. A draw from a global generator on the fifth level, or a list that
all instances share, affects only the agent that gets there, after days of training.

## Example
```python
class Orchard(gym.Env):
    picked = []                        # one list for all instances

    def step(self, action):
        if self.level == 5:
            self.wind = random.random()    # EC050: use self.np_random.random()
        self.picked.append(self.tree)      # EC053: create the list in reset()
```
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.model.target import Kind, parse
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl

from .linting.absorbed import absorbed_ends
from .linting.actions import impossible_actions
from .linting.backgrounds import background_colours
from .linting.calls import wrong_arguments
from .linting.clock import clocks
from .linting.collisions import colliding_places
from .linting.costs import paying_costs
from .linting.dead import late_results, repeated_tests
from .linting.discarded import discarded_results
from .linting.dtypes import float_pictures
from .linting.early import early_successes
from .linting.effects import effects, swallowed
from .linting.equal import equal_values
from .linting.fractions import vanishing_fractions
from .linting.generators import generators
from .linting.iterated import shrinking_loops
from .linting.lasting import lasting_parts
from .linting.late import late_pictures
from .linting.lateness import late_successes
from .linting.leftovers import leftovers
from .linting.levels import outgrown_tables
from .linting.limits import other_limits
from .linting.logic import contradictions, divisions
from .linting.offscreen import offscreen_drawings
from .linting.order import orders
from .linting.outdated import outdated_generators
from .linting.overflow import overflows
from .linting.owed import early_differences, owed_rewards
from .linting.pairs import short_comparisons
from .linting.parts import parts_read_twice
from .linting.powers import powers
from .linting.program import Program, Suspect, in_words
from .linting.punished import punished_successes
from .linting.remembered import remembered
from .linting.rendering import drawn_changes, drawn_numbers
from .linting.results import wrong_results
from .linting.running_out import short_lists
from .linting.sharing import aliases, shared
from .linting.skipped import skipped_numbers
from .linting.squares import squared_distances
from .linting.stopping import stopped_pictures
from .linting.success import unreachable_successes
from .linting.sums import floats
from .linting.swaps import swapped_rows
from .linting.tables import shared_items
from .linting.timestamps import stale_times
from .linting.transposed import transposed_pictures
from .linting.undefined import undefined_names
from .linting.unending import ongoing_successes
from .linting.unpaid import unpaid_successes
from .linting.waiting import waiting_pays
from .linting.wrapping import empty_slices, unsigned, wrapped_indices

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject

#: A larger file than any game is not read, since some rules compare all places with each other.
_NODES = 25_000
#: The most lines of one rule that a finding names.
_LINES = 20

_FINDERS: tuple[tuple[str, Callable[[Program], Iterator[Suspect]]], ...] = (
    ("EC050", generators),
    ("EC050", outdated_generators),
    ("EC051", clocks),
    ("EC052", orders),
    ("EC053", shared),
    ("EC053", shared_items),
    ("EC053", leftovers),
    ("EC053", remembered),
    ("EC054", aliases),
    ("EC055", effects),
    ("EC056", floats),
    ("EC056", skipped_numbers),
    ("EC056", lasting_parts),
    ("EC057", divisions),
    ("EC058", swallowed),
    ("EC058", wrapped_indices),
    ("EC059", contradictions),
    ("EC059", unreachable_successes),
    ("EC059", impossible_actions),
    ("EC059", repeated_tests),
    ("EC059", late_results),
    ("EC059", late_pictures),
    ("EC059", unsigned),
    ("EC059", early_successes),
    ("EC060", ongoing_successes),
    ("EC059", equal_values),
    ("EC059", other_limits),
    ("EC059", owed_rewards),
    ("EC059", short_comparisons),
    ("EC059", parts_read_twice),
    ("EC059", empty_slices),
    ("EC059", absorbed_ends),
    ("EC059", colliding_places),
    ("EC059", vanishing_fractions),
    ("EC061", wrong_results),
    ("EC062", punished_successes),
    ("EC062", unpaid_successes),
    ("EC062", late_successes),
    ("EC062", early_differences),
    ("EC063", drawn_changes),
    ("EC063", drawn_numbers),
    ("EC064", float_pictures),
    ("EC065", waiting_pays),
    ("EC066", stopped_pictures),
    ("EC067", short_lists),
    ("EC068", paying_costs),
    ("EC069", overflows),
    ("EC070", transposed_pictures),
    ("EC071", powers),
    ("EC072", offscreen_drawings),
    ("EC073", background_colours),
    ("EC074", swapped_rows),
    ("EC075", stale_times),
    ("EC076", undefined_names),
    ("EC077", wrong_arguments),
    ("EC078", discarded_results),
    ("EC079", squared_distances),
    ("EC080", outgrown_tables),
    ("EC081", shrinking_loops),
)


class Lint(Check):
    name = "lint"
    rules = (
        Rule(
            "EC050",
            "unseeded-draw",
            "The code draws random numbers that no seed of reset() controls.",
            "Draw from self.np_random, seeded by super().reset(seed=seed).",
            confirmed_by=("EC201", "EC202", "EC204", "EC205", "EC206", "EC207"),
        ),
        Rule(
            "EC051",
            "clock-in-game",
            "The code reads the clock and uses the time in the game.",
            "Count steps instead of reading the time.",
            confirmed_by=("EC201", "EC205"),
        ),
        Rule(
            "EC052",
            "hash-order",
            "The code uses an order or a number that depends on hashes or addresses.",
            "Sort a set before using its order; in place of id() or hash(), use a number that each object keeps.",
            confirmed_by=("EC201", "EC202", "EC203"),
        ),
        Rule(
            "EC053",
            "shared-state",
            "The code changes state that episodes or instances share.",
            "Keep state in self, and create it in reset().",
            confirmed_by=("EC104", "EC107", "EC206", "EC207", "EC910", "EC912", "EC913"),
        ),
        Rule(
            "EC054",
            "shared-array",
            "The code returns what it changes later, or keeps or changes the caller's action.",
            "Return a copy, and copy the action.",
            confirmed_by=("EC110", "EC111", "EC215"),
        ),
        Rule(
            "EC055",
            "outside-effect",
            "The code opens files or sockets, or starts threads or processes.",
            "Keep everything in the environment's own memory.",
            Severity.WARNING,
            confirmed_by=("EC911", "EC912"),
        ),
        Rule(
            "EC056",
            "exact-float",
            "A test of the end compares a sum with ==, which may miss the number.",
            "Compare with >= or <=.",
        ),
        Rule(
            "EC057",
            "unguarded-arithmetic",
            "The code divides without a test for zero.",
            "Use max(divisor, 1e-8).",
            Severity.WARNING,
            default=False,
        ),
        Rule(
            "EC058",
            "swallowed-exception",
            "The code catches every exception and does nothing, or tests borders by IndexError alone.",
            "Catch the exception that you expect, handle it, and test an index for < 0.",
            Severity.WARNING,
        ),
        Rule(
            "EC059",
            "contradiction",
            "A test can never be true, or a change of the result comes too late.",
            "Compare with a value that can be reached, and change the result before the tuple is built.",
        ),
        Rule(
            "EC060",
            "success-ends-nothing",
            "Nothing that success depends on can end the episode.",
            "Set terminated on success, or report success only at the end.",
            Severity.WARNING,
            confirmed_by=("EC506",),
        ),
        Rule(
            "EC061",
            "wrong-result",
            "step() swaps its flags, or returns an info that is not a dict or lacks success.",
            "Return observation, reward, terminated, truncated and a dict, in this order.",
            confirmed_by=("EC106", "EC114", "EC501", "EC502", "EC506", "EC507", "EC509", "EC510"),
        ),
        Rule(
            "EC062",
            "success-punished",
            "Progress towards success has a negative reward, or the step of success loses its reward.",
            "Pay for progress and for success; do not change the sign of the reward.",
            confirmed_by=("EC305", "EC308"),
        ),
        Rule(
            "EC063",
            "render-changes-game",
            "render() changes state that step() reads, or draws from the game's random generator.",
            "Change the state and draw random numbers in step(), and only draw the picture in render().",
            confirmed_by=("EC208", "EC501"),
        ),
        Rule(
            "EC064",
            "float-picture",
            "A branch makes the observation float64, or writes floats into an array of uint8.",
            "Convert the picture at the end of the branch: `.astype(np.uint8)`.",
            confirmed_by=("EC104", "EC107", "EC108", "EC112"),
        ),
        Rule(
            "EC065",
            "waiting-pays",
            "Each step, or holding a button, pays more than success, which ends the episode.",
            "Pay for progress and for success, not for time or for the action itself.",
            confirmed_by=("EC304", "EC307", "EC308", "EC602"),
        ),
        Rule(
            "EC066",
            "picture-stops",
            "After an event the observation shows nothing new until reset().",
            "Draw the state after the event, too, or end the episode there.",
            confirmed_by=("EC401", "EC402", "EC403", "EC404", "EC405"),
        ),
        Rule(
            "EC067",
            "list-runs-out",
            "The code reads a list of a fixed length by a counter that nothing limits.",
            "Use min(self.counter, len(items) - 1), or end the episode before the last item.",
            Severity.WARNING,
            confirmed_by=("EC107",),
        ),
        Rule(
            "EC068",
            "cost-pays",
            "A cost has the wrong sign, so it increases the reward.",
            "Subtract a positive cost, or add a negative one.",
        ),
        Rule(
            "EC069",
            "bytes-wrap",
            "Arithmetic of unsigned integers of NumPy wraps around.",
            "Convert first: `array.astype(int)`.",
        ),
        Rule(
            "EC070",
            "picture-transposed",
            "The picture has the axes of a pygame surface: x first, then y.",
            "Return `np.transpose(pygame.surfarray.array3d(surface), (1, 0, 2))`.",
        ),
        Rule(
            "EC071",
            "reward-explodes",
            "The reward is a power of a counter that nothing limits.",
            "Limit the counter: `2 ** min(self.streak, 4)`.",
            confirmed_by=("EC303",),
        ),
        Rule(
            "EC072",
            "drawn-outside",
            "The code draws what play changes beyond the edge of the picture.",
            "Draw inside the picture, or make it larger.",
        ),
        Rule(
            "EC073",
            "background-colour",
            "Something is drawn in the colour that the background has in some levels.",
            "Give it a colour that no background has.",
        ),
        Rule(
            "EC074",
            "rows-swapped",
            "An assignment swaps rows of an array, which makes both the same.",
            "Swap copies: `a[[i, j]] = a[[j, i]]`.",
        ),
        Rule(
            "EC075",
            "time-outlives-clock",
            "Play sets a step counter back to 0, but not a time that the code compares with the counter.",
            "Reset the time together with the counter, or let the counter run on.",
        ),
        Rule(
            "EC076",
            "undefined-name",
            "The code reads a name or an attribute that nothing defines.",
            "Correct the spelling, or define it.",
            confirmed_by=("EC008", "EC104", "EC107", "EC112"),
        ),
        Rule(
            "EC077",
            "wrong-arguments",
            "The code calls one of its functions with arguments that the function does not take.",
            "Give the arguments that the function's definition lists.",
            confirmed_by=("EC008", "EC104", "EC107", "EC112"),
        ),
        Rule(
            "EC078",
            "discarded-result",
            "A statement computes a value and does nothing with it.",
            "Assign the result, or call the method that changes its object.",
        ),
        Rule(
            "EC079",
            "squared-distance",
            "A test compares a squared distance with a distance.",
            "Square the other side as well: `dx * dx + dy * dy <= reach * reach`.",
        ),
        Rule(
            "EC080",
            "table-too-short",
            "A level may reach a number for which a table has no item.",
            "Give each table that the level reads one item per level, the highest included.",
            confirmed_by=("EC107",),
        ),
        Rule(
            "EC081",
            "removal-in-loop",
            "A loop removes items from what it iterates over.",
            "Iterate over a copy, `for item in list(self.items)`, or build a new list of the items that stay.",
            confirmed_by=("EC107",),
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if subject.target.kind is not Kind.SOURCE:
            raise Skip("only files are read, not installed packages")
        try:
            program = Program(parse(subject.text), subject.class_statement)
            if len(program.nodes) > _NODES:
                raise Skip(f"the syntax tree has more than {_NODES:,} nodes")
            found: dict[str, dict[Suspect, None]] = {}
            for code, finder in _FINDERS:
                found.setdefault(code, {}).update(dict.fromkeys(finder(program)))
        except RecursionError:
            raise Skip("the code is nested too deeply") from None
        for code, suspects in found.items():
            if suspects:
                ordered = sorted(suspects, key=lambda suspect: not suspect.certain)
                words, lines = in_words(ordered)
                finding = self.finding(code, words, line=ordered[0].line, lines=lines[:_LINES])
                yield finding if ordered[0].certain else finding.as_warning()


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Lint()]
