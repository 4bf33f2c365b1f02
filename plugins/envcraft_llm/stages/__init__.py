"""The stages from a concept to an environment, one per file."""

from __future__ import annotations

from envcraft.generation.stages import Stage

from .briefs import Briefs
from .code import Code
from .concepts import Concepts
from .elaboration import Elaboration
from .filters import Instadeath, Instawin
from .privileged import Privileged
from .repair import Repair
from .validated import Validated
from .viability import Viability

#: In the order in which they run.
STAGES: tuple[type[Stage], ...] = (
    Concepts,
    Briefs,
    Viability,
    Code,
    Repair,
    Instawin,
    Instadeath,
    Privileged,
    Validated,
)
#: Run only if ``--with`` names them.
OPTIONAL: tuple[type[Stage], ...] = (Elaboration,)

__all__ = [
    "OPTIONAL",
    "STAGES",
    "Briefs",
    "Code",
    "Concepts",
    "Elaboration",
    "Instadeath",
    "Instawin",
    "Privileged",
    "Repair",
    "Validated",
    "Viability",
]
