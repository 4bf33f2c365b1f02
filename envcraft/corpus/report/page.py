"""The templates and the assets of the pages, and the policy that all pages share."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from envcraft.judging.statistics import Proportion
from envcraft.model.verdict import plain
from envcraft.text import one_line, printable

TEMPLATES = Path(__file__).with_name("templates")
ASSETS = "assets"
_PALETTE = Path(__file__).parents[2] / "reports" / "palette.css"
_STYLES = ("style.css", "environment.css")
#: A page that is opened as a file has no origin, so its own files are allowed by their scheme.
_POLICY = (
    "default-src 'none'; img-src 'self' file: data:; style-src 'self' file:; script-src 'self' file:; "
    "connect-src {}; base-uri 'none'; form-action 'none'"
)


class Pages:
    """The pages of a site, with their style and scripts as files.

    Args:
        folder: the folder of the site.
        live: whether a server with environments to play serves the site.
    """

    def __init__(self, folder: Path, live: bool = False) -> None:
        import jinja2

        self._folder, self._live = folder, live
        self._environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(TEMPLATES),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self._environment.filters |= {
            "count": lambda value: f"{value:,}",
            "number": number,
            "share": lambda value: f"{value:.1%}",
            "interval": interval,
            "one_line": one_line,
            "times": times,
            "address": address,
        }
        assets = folder / ASSETS
        assets.mkdir(exist_ok=True)
        styles = [_PALETTE, *(TEMPLATES / name for name in _STYLES)]
        (assets / "style.css").write_text("".join(path.read_text("utf-8") for path in styles), "utf-8")

    def write(self, name: str, scripts: Sequence[str], **values: Any) -> None:
        """Render a page. Its content security policy allows only files of the site.

        Args:
            name: of the template and of the page.
            scripts: the names of the files that its script consists of, in order.
            values: the variables of the template.
        """
        # One file, because each request takes time.
        script = f"{ASSETS}/{Path(name).stem}.js"
        (self._folder / script).write_text("".join((TEMPLATES / one).read_text("utf-8") for one in scripts), "utf-8")
        policy = _POLICY.format("'self'" if self._live else "'none'")
        values |= {"policy": policy, "live": self._live, "script": script, "style": f"{ASSETS}/style.css"}
        page = self._environment.get_template(name).render(**values)
        (self._folder / name).write_text(printable(page), "utf-8")


def data(value: Any) -> str:
    """JSON in which an HTML parser finds no end of a script."""
    return json.dumps(plain(value)).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def number(value: float) -> str:
    """A number with about three digits: ``0.042``, ``3.14``, ``1,250``."""
    if value >= 100 or value == int(value):
        return f"{value:,.0f}"
    return f"{value:.1f}" if value >= 10 else f"{value:.3g}"


def times(ratio: float) -> str:
    """A ratio as a factor, or as a fraction such as ``1/64`` if it is below 0.1."""
    if ratio < 0.1:
        return f"1/{1 / ratio:,.0f}"
    return f"{number(ratio) if ratio >= 1 else f'{ratio:.2f}'}\N{MULTIPLICATION SIGN}"


def interval(rate: Proportion) -> str:
    """An interval such as ``96.1 - 97.9%``, with an en dash."""
    return f"{100 * rate.low:.1f}\N{EN DASH}{100 * rate.high:.1f}%" if rate.n else ""


def address(name: str) -> str:
    """The address of an environment's page, relative to the folder of the site."""
    from urllib.parse import quote_plus

    return f"environments.html#environment={quote_plus(one_line(name))}"
