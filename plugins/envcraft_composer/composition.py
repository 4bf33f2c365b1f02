"""A composition: the mechanics, constants and look of one game, and the source that they give."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from random import Random

from envcraft.environments.source_builder import SourceBuilder, paragraph
from envcraft_composer.avatars import AVATARS
from envcraft_composer.goals import GOALS
from envcraft_composer.looks import ROLES, SPRITES, TEXTURES, WALLS, Look
from envcraft_composer.mechanic import Constants, Mechanic, fits
from envcraft_composer.mechanics import found
from envcraft_composer.pressures import DANGERS, PRESSURES
from envcraft_composer.skeleton import SKELETON
from envcraft_composer.twists import TWISTS
from envcraft_composer.worlds import WORLDS

#: The groups of mechanics, in the order of their sentences and code.
GROUPS: dict[str, tuple[Mechanic, ...]] = {
    name: listed + found(name)
    for name, listed in (
        ("world", WORLDS),
        ("avatar", AVATARS),
        ("goal", GOALS),
        ("twist", TWISTS),
        ("danger", DANGERS),
        ("pressure", PRESSURES),
    )
}
#: Shapes of all pictures, by name.
_SHAPES = dict(SPRITES)
for _mechanics in GROUPS.values():
    for _mechanic in _mechanics:
        _SHAPES |= _mechanic.shapes
#: Steps between two things, as a share of the mean length of a world's sides.
_APART = 0.45
#: The time limit as a multiple of the steps that a good player needs, on the easiest and the hardest level.
_SLACK = (10.0, 2.0)
#: Constants in one line.
_TOGETHER = 6
_LEAST_TIME, _MOST_TIME = 80, 960


@dataclass(frozen=True)
class Composition:
    """One game.

    Attributes:
        mechanics: One of each group, by the names of the groups.
        constants: The constants of the game's module.
        look: Its look.
    """

    mechanics: dict[str, Mechanic]
    constants: Constants
    look: Look

    @classmethod
    def draw(cls, rng: Random, mechanics: dict[str, Mechanic], level: float) -> Composition:
        """Draw the constants and the look of a game with these mechanics, at a level of difficulty from 0 to 1."""
        constants: Constants = {}
        goal = mechanics["goal"]
        for mechanic in mechanics.values():
            constants |= mechanic.draw(rng, level)
        size = _size(constants)
        if goal.name == "escort":
            # A train of chicks keeps apart: a cell, or the points of some steps.
            constants["PACE"] = 1 if "ROWS" in constants else 4
        slow = mechanics["avatar"].pace * mechanics["twist"].pace
        pace = goal.pace * mechanics["world"].pace * slow
        things = int(str(constants.get("COUNT", 0)))
        needed = goal.area * size * size * slow if goal.area else things * _APART * size * pace + size
        slack = _SLACK[0] * (_SLACK[1] / _SLACK[0]) ** level
        constants["TIME"] = round(min(max(slack * needed, _LEAST_TIME), _MOST_TIME))
        constants["POINT"] = round(rng.uniform(2, 8) / (size * size * 0.8 if goal.area else things), 3)
        constants["PRIZE"] = round(rng.uniform(2, 10), 1)
        constants["PENALTY"] = round(rng.uniform(0.5, 3), 1)
        constants["COST"] = round(rng.uniform(0.001, 0.02), 4)
        if any("self.reward -= HARM" in text for part in mechanics.values() for text in part.parts.values()):
            constants["HARM"] = round(rng.uniform(0.2, 1), 2)
        return cls(mechanics, constants, Look.draw(rng, _SHAPES))

    @property
    def title(self) -> str:
        names = {group: mechanic.name for group, mechanic in self.mechanics.items()}
        return f"{names['goal'].capitalize()} in the world {names['world']} with the avatar {names['avatar']}"

    def write(self, class_name: str) -> str:
        """The source of the game."""
        builder = SourceBuilder()
        parts = list(self.mechanics.values())
        builder.add("title", f"{self.title}.")
        builder.add("about", self._about())
        builder.add("class", class_name)
        builder.add("colours", ROLES)
        builder.add("palette", self.look.palette)
        builder.add("actions", ", ".join(map(str, self.mechanics["avatar"].actions)))
        if TEXTURES[self.look.texture]:
            builder.add("texture", "\n" + TEXTURES[self.look.texture])
        builder.add("wall", "\n" + WALLS[self.look.wall])
        builder.add("constants", *_lines(self.constants))
        for name in dict.fromkeys(["HERO", *(sprite for part in parts for sprite in part.sprites)]):
            builder.add("sprites", f'{name} = sprite("{_SHAPES[name][self.look.shapes[name]]}")')
        slots: dict[str, list[str]] = {}
        methods: dict[str, str] = {}
        for part in parts:
            for slot, code in part.parts.items():
                if slot.startswith("method:"):
                    methods[slot] = code
                else:
                    slots.setdefault(slot, []).append(code.replace("\n\n", "\n"))
        if "method:push" in methods:
            # Where the goal is to push, each step of the avatar pushes.
            for slot in ("act", "stir"):
                slots[slot] = [code.replace("self._shift(self.at, ", "self._push(") for code in slots.get(slot, ())]
        for slot, codes in slots.items():
            builder.add(slot, *("\n" + code for code in codes))
        builder.add("methods", *("\n" + code for code in methods.values()))
        if "_harm()" in "".join(slots.get("touch", ())):
            builder.add("again", "self._touch()")
        return builder.render(SKELETON)

    def _about(self) -> str:
        about = {group: _one(mechanic.about.format_map(self.constants)) for group, mechanic in self.mechanics.items()}
        goal = about.pop("goal")
        numbers = self.constants
        rewards = (
            f"Rewards: {numbers['POINT']} for each part of progress beyond the best, {numbers['PRIZE']} for the goal, "
            f"-{numbers['PENALTY']} for a loss, -{numbers['COST']} for each step"
        )
        rewards += f", -{numbers['HARM']} for an accident." if "HARM" in numbers else "."
        rest = paragraph(*(text for text in about.values() if text))
        controls = paragraph("Controls:", self.mechanics["avatar"].controls)
        bar = "The bar at the top left shows the progress."
        return "\n\n".join([rest, paragraph(goal, bar), controls, paragraph(rewards)])


def _one(text: str) -> str:
    """The text in the singular where a number is one."""
    return text.replace(", one step in every 1.", " in every step.").replace(" 1 cells far", " 1 cell far")


def _lines(constants: Constants) -> Iterator[str]:
    """Assignments to constants, some in each line."""
    items = list(constants.items())
    for start in range(0, len(items), _TOGETHER):
        some = items[start : start + _TOGETHER]
        yield f"{', '.join(name for name, _ in some)} = {', '.join(repr(value) for _, value in some)}"


def _size(constants: Constants) -> float:
    """The mean length of a world's sides, in steps of the avatar."""
    if "ROWS" in constants:
        return (float(str(constants["ROWS"])) + float(str(constants["COLUMNS"]))) / 2
    return 78 / float(str(constants["SPEED"]))


def cores() -> list[dict[str, Mechanic]]:
    """All worlds, avatars and goals that fit together."""
    return [
        {"world": world, "avatar": avatar, "goal": goal}
        for world, avatar, goal in product(GROUPS["world"], GROUPS["avatar"], GROUPS["goal"])
        if fits((world, avatar, goal))
    ]


def combinations(core: dict[str, Mechanic]) -> list[dict[str, Mechanic]]:
    """All sets of mechanics, one of each group, that fit together and have this core."""
    given = frozenset().union(*(mechanic.gives for mechanic in core.values()))
    twists = [twist for twist in GROUPS["twist"] if twist.needs <= given and not twist.bars & given]
    sets = product(*([mechanic] for mechanic in core.values()), twists, GROUPS["danger"], GROUPS["pressure"])
    return [dict(zip(GROUPS, chosen, strict=True)) for chosen in sets if fits(chosen)]
