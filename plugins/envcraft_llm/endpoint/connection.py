"""The client of an endpoint, and how the endpoint is named without what must not be told."""

from __future__ import annotations

import resource
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from envcraft.errors import UsageError

from .settings import ModelChoice, key_from_environment

if TYPE_CHECKING:
    from openai import AsyncOpenAI

#: What is shorter is no secret but a word, such as EMPTY, that servers of one's own are given and programs have too.
_SECRET = 12
#: Connections beside those of requests, and files beside connections.
_SPARE, _FILES = 8, 512


class Connection:
    """A client with the key of the environment.

    Attributes:
        where: the address, without name, password and query.
        key_name: the environment variable that holds the key.
        has_key: whether it does.

    Raises UsageError where the client is not installed, or no endpoint is named.
    """

    def __init__(self, choice: ModelChoice) -> None:
        check(choice)
        self.key_name, self._key = key_from_environment()
        self.has_key = bool(self._key)
        self.where = shown_address(choice.base_url)
        self.client = _client(choice, self._key)

    def plain(self, text: str) -> str:
        """What an endpoint said of a request, without the key, which some repeat."""
        return text.replace(self._key, "[key]") if self._key else text

    def answered(self, text: str) -> str:
        """What a model wrote, without the key: to the letter, unless that is a secret."""
        return self.plain(text) if len(self._key) >= _SECRET else text


def check(choice: ModelChoice) -> None:
    """Look whether an endpoint can be asked. Raises UsageError where the client is not installed, none is named, or
    the key or a password cannot be sent.
    """
    if not choice.base_url:
        raise UsageError(
            "no endpoint is named: give --base-url, such as http://127.0.0.1:8000/v1, or set base-url in "
            "[tool.envcraft.llm] of pyproject.toml"
        )
    name, key = key_from_environment()
    if "@" in choice.base_url.split("/")[2]:
        raise UsageError(
            f"the address of {shown_address(choice.base_url)} has a name or a password before the host, which cannot "
            f"be sent beside a key: leave it out, and put what the endpoint asks for into {name}"
        )
    if not (key.isascii() and key.isprintable()):
        raise UsageError(
            f"{name} has a letter that no key has, such as a typographic quote or the end of a line: copy the key anew"
        )
    try:
        # Without it the client's class is there all the same.
        import aiohttp  # noqa: F401
        from openai import DefaultAioHttpClient  # noqa: F401
    except ImportError:
        raise UsageError(
            "asking an endpoint needs its client; install it with `pip install 'envcraft-rl[llm]'`"
        ) from None


def shown_address(address: str) -> str:
    """An address without what may be secret in it: what stands before the last ``@`` of the host, and the query."""
    try:
        parts = urlsplit(address)
    except ValueError:
        return "the address of --base-url"
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"


def _client(choice: ModelChoice, key: str) -> AsyncOpenAI:
    from openai import DEFAULT_CONNECTION_LIMITS, AsyncOpenAI, DefaultAioHttpClient, Timeout

    # Of the library below the client, which is not the same for all its versions.
    limits = type(DEFAULT_CONNECTION_LIMITS)
    places = choice.max_concurrency + _SPARE
    _allow_files(places)
    return AsyncOpenAI(
        base_url=choice.base_url,
        # One is sent in any case; endpoints of one's own rarely look at it.
        api_key=key or "none",
        # Attempts are repeated here, where the pace is known.
        max_retries=0,
        timeout=Timeout(None, connect=choice.connect_seconds),
        # What it costs does not grow with the number of connections.
        http_client=DefaultAioHttpClient(limits=limits(max_connections=places, max_keepalive_connections=places)),
    )


def _allow_files(connections: int) -> None:
    """Allow this process so many connections, where the system does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = connections + _FILES
    if soft != resource.RLIM_INFINITY and soft < wanted:
        most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, most), hard))
