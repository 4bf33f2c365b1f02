"""A page of a few kinds of parts, as Markdown and as HTML."""

from __future__ import annotations

import html
from collections.abc import Sequence

_HEAD = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #1f2430; }}
table {{ border-collapse: collapse; display: block; overflow-x: auto; margin: 1rem 0; }}
th, td {{ padding: .25rem .75rem; border-bottom: 1px solid #d8dbe2; text-align: right; white-space: nowrap; }}
th:first-child, td:first-child {{ text-align: left; }}
img {{ max-width: 100%; }}
figure {{ margin: 1.5rem 0; }}
figcaption {{ color: #6b7280; }}
pre {{ overflow-x: auto; background: #f4f5f7; padding: .75rem; }}
</style>
</head>
<body>
"""


class Page:
    """Takes parts one after the other. Words are plain text, and mean nothing in either language."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._markdown = [f"# {_plain(title)}"]
        self._html = [_HEAD.format(title=html.escape(title)), f"<h1>{html.escape(title)}</h1>"]

    def heading(self, words: str) -> None:
        self._markdown.append(f"## {_plain(words)}")
        self._html.append(f"<h2>{html.escape(words)}</h2>")

    def text(self, words: str) -> None:
        self._markdown.append(_plain(words))
        self._html.append(f"<p>{html.escape(words)}</p>")

    def code(self, words: str) -> None:
        self._markdown.append(f"```console\n{words}\n```")
        self._html.append(f"<pre>{html.escape(words)}</pre>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """The first column is of words, the others of numbers."""
        lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
        cells = [
            [_plain(cell).replace("|", "\\|") if line is not lines[1] else cell for cell in line] for line in lines
        ]
        self._markdown.append("\n".join(f"| {' | '.join(line)} |" for line in cells))
        body = "\n".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        top = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
        self._html.append(f"<table>\n<thead><tr>{top}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>")

    def figure(self, file: str, words: str) -> None:
        self._markdown.append(f"![{_plain(words)}]({file})")
        shown = html.escape(words)
        self._html.append(
            f'<figure><img src="{html.escape(file)}" alt="{shown}"><figcaption>{shown}</figcaption></figure>'
        )

    def markdown(self) -> str:
        return "\n\n".join(self._markdown) + "\n"

    def html(self) -> str:
        return "\n".join([*self._html, "</body>", "</html>"]) + "\n"


def _plain(words: str) -> str:
    """Without what Markdown would take for markup."""
    for sign in "\\`*_[]<>":
        words = words.replace(sign, f"\\{sign}")
    return words
