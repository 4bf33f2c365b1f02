"""The mutation operators, one module for each kind of defect. Importing the package registers all of them."""

from benchmarks.mutation.operator import OPERATORS
from benchmarks.mutation.operators import (
    difficulty,
    endings,
    interface,
    pictures,
    randomness,
    resources,
    rewards,
    state,
)

__all__ = ["OPERATORS", "difficulty", "endings", "interface", "pictures", "randomness", "resources", "rewards", "state"]
