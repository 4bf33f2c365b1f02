"""A matplotlib figure as markup that a page can style: colours become classes, nothing in it has a style of its own.

The page's policy allows no inline style, and its colours depend on the reader's scheme.
"""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: What is drawn in these colours gets the class ``f-NAME`` or ``s-NAME``, for its fill or its stroke.
COLOURS = {
    name: f"#0{number:x}0{number:x}0{number:x}"
    for number, name in enumerate(("ink", "soft", "line", "pass", "fail", "error", "skip", "accent", "paper"), 1)
}
_NAMES = {colour: name for name, colour in COLOURS.items()}
_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"
_FONT_SIZE = re.compile(r"([\d.]+)px")


def markup(figure: Figure, name: str, words: str) -> str:
    """The figure as an ``<svg>`` element; `words` say in a sentence what it shows, and `name` begins the ids in it."""
    written = io.StringIO()
    figure.savefig(written, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    # It is our own writing of a moment ago.
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
    told = " ".join(element.attrib.values())
    return [*re.findall(r"url\(#([^)]+)\)", told), element.attrib.get(_XLINK, "").removeprefix("#")]


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
    """One declaration of a style, as an attribute or a class."""
    key, value = key.strip(), value.strip()
    if key in ("fill", "stroke") and value in _NAMES:
        classes.append(f"{key[0]}-{_NAMES[value]}")
    elif key in ("font", "font-size"):
        # A shorthand or not, as the version of matplotlib has it; the family is the page's.
        if size := _FONT_SIZE.search(value):
            attributes["font-size"] = size[1]
    elif key and not key.startswith("font"):
        attributes[key] = value
