"""The nodes of a syntax tree, which each check of a subject looks at."""

import ast
import gc
import weakref
from pathlib import Path

from envcraft.model.target import nodes, walk

SOURCE = (Path(__file__).parents[2] / "examples" / "snake.py").read_text("utf-8")


def test_a_walk_has_the_order_of_the_standard_library() -> None:
    tree = ast.parse(SOURCE)
    assert walk(tree) == list(ast.walk(tree))
    assert walk(tree.body[-1]) == list(ast.walk(tree.body[-1]))


def test_a_tree_keeps_its_nodes() -> None:
    tree = ast.parse(SOURCE)
    found = nodes(tree)
    found.clear()
    assert nodes(tree) == list(ast.walk(tree))
    assert ast.dump(tree) == ast.dump(ast.parse(SOURCE))


def test_a_tree_does_not_outlive_its_use() -> None:
    class Tree(ast.Module):
        pass

    tree = Tree(ast.parse(SOURCE).body, [])
    nodes(tree)
    gone = weakref.ref(tree)
    gc.disable()
    try:
        del tree
        assert gone() is None
    finally:
        gc.enable()
