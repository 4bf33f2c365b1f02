"""Markdown for a terminal, with code as it is written."""

from __future__ import annotations

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import CodeBlock, Markdown
from rich.syntax import Syntax


class _Code(CodeBlock):
    """A block of code whose lines are not wrapped and have no margin."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        text = Syntax("", self.lexer_name, background_color="default").highlight(str(self.text))
        text.no_wrap, text.overflow = True, "ignore"
        text.rstrip()
        yield text


class Page(Markdown):
    """A page whose code can be copied."""

    elements = {**Markdown.elements, "fence": _Code, "code_block": _Code}
