"""Convert a matplotlib figure to markup without inline styles, in which colours are classes.

The page's content security policy forbids inline styles, and its colours depend on the reader's colour scheme.
"""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: A fill in one of these colours becomes the class ``f-NAME``, a stroke the class ``s-NAME``.
COLOURS = {
    name: f"#0{number:x}0{number:x}0{number:x}"
    for number, name in enumerate(
        ("ink", "soft", "line", "pass", "fail", "error", "skip", "accent", "paper", "undecided"), 1
    )
}
_NAMES = {colour: name for name, colour in COLOURS.items()}
_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
_FONT_SIZE = re.compile(r"([\d.]+)px")


def markup(figure: Figure, name: str, words: str) -> str:
    """Return the figure as an ``<svg>`` element.

    Args:
        figure: the figure.
        name: the prefix of the ids in it.
        words: a sentence that describes the figure to people who cannot see it.
    """
    written = io.StringIO()
    figure.savefig(written, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    # matplotlib wrote this text, so the parser's attacks do not apply.
    root = ElementTree.fromstring(written.getvalue())  # noqa: S314
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag.removeprefix(_SVG) in ("metadata", "style"):
                parent.remove(child)
    used = {match for element in root.iter() for match in _references(element)}
    for element in root.iter():
        _plain(element, name, used)
    for size in ("width", "height"):
        root.attrib.pop(size, None)
    root.attrib |= {"role": "img", "aria-label": words, "class": "chart"}
    return ElementTree.tostring(root, encoding="unicode").replace("\n", "")


def _references(element: ElementTree.Element) -> list[str]:
    values = " ".join(element.attrib.values())
    return [*re.findall(r"url\(#([^)]+)\)", values), element.attrib.get(_XLINK, "").removeprefix("#")]


def _plain(element: ElementTree.Element, name: str, used: set[str]) -> None:
    element.tag = element.tag.removeprefix(_SVG)
    attributes: dict[str, Any] = {}
    classes: list[str] = []
    for key, value in element.attrib.items():
        if key == "id":
            if value in used:
                attributes["id"] = f"{name}-{value}"
        elif key == _XLINK:
            attributes["href"] = f"#{name}-{value.removeprefix('#')}"
        elif key == "style":
            for part in value.split(";"):
                _take(*part.partition(":")[::2], attributes, classes)
        else:
            attributes[key] = value.replace("url(#", f"url(#{name}-")
    if classes:
        attributes["class"] = " ".join(classes)
    element.attrib = attributes


def _take(key: str, value: str, attributes: dict[str, Any], classes: list[str]) -> None:
    """Convert one declaration of a style to an attribute or a class."""
    key, value = key.strip(), value.strip()
    if key in ("fill", "stroke") and value in _NAMES:
        classes.append(f"{key[0]}-{_NAMES[value]}")
    elif key in ("font", "font-size"):
        # Some versions of matplotlib write the shorthand. The page sets the font family.
        if size := _FONT_SIZE.search(value):
            attributes["font-size"] = size[1]
    elif key and not key.startswith("font"):
        attributes[key] = value
