"""The HTTP client of an endpoint, and the redaction of secrets from what is shown and stored."""

from __future__ import annotations

import resource
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from envcraft.errors import UsageError

from .settings import ModelSettings, key_from_environment

if TYPE_CHECKING:
    from openai import AsyncOpenAI

#: Minimum length of a secret key. A shorter one is a placeholder such as EMPTY, a word that programs contain too.
_SECRET_LENGTH = 12
#: Connections beside those of requests, and files beside connections.
_SPARE_CONNECTIONS, _SPARE_FILES = 8, 512


class Connection:
    """An `openai` client with the key of the environment.

    Attributes:
        client: The client.
        address: Address of the endpoint, without credentials and query.
        key_name: Environment variable that holds the key.
        has_key: Whether that variable is set.

    Raises:
        UsageError: If the client is not installed, or no endpoint is configured.
    """

    def __init__(self, settings: ModelSettings) -> None:
        check_endpoint(settings)
        self.key_name, self._key = key_from_environment()
        self.has_key = bool(self._key)
        self.address = redacted_address(settings.base_url)
        self.client = _client(settings, self._key)

    def redact(self, text: str) -> str:
        """Remove the key from a message of the endpoint; some endpoints repeat it."""
        return text.replace(self._key, "[key]") if self._key else text

    def redact_completion(self, text: str) -> str:
        """Remove the key from what a model wrote, unless it is too short to be a secret."""
        return self.redact(text) if len(self._key) >= _SECRET_LENGTH else text


def check_endpoint(settings: ModelSettings) -> None:
    """Check that requests can be sent.

    Raises:
        UsageError: If the client is not installed, no endpoint is configured, or the key cannot be sent.
    """
    if not settings.base_url:
        raise UsageError(
            "no endpoint is configured: give --base-url, such as http://127.0.0.1:8000/v1, or set base-url in "
            "[tool.envcraft.llm] of pyproject.toml"
        )
    name, key = key_from_environment()
    if "@" in settings.base_url.split("/")[2]:
        raise UsageError(
            f"the address {redacted_address(settings.base_url)} has credentials before the host, which cannot be sent "
            f"beside a key: remove them, and put the endpoint's key into {name}"
        )
    if not (key.isascii() and key.isprintable()):
        raise UsageError(
            f"{name} has a character that no key has, such as a typographic quote or a line break: copy the key again"
        )
    try:
        # Without aiohttp the client's class exists all the same.
        import aiohttp  # noqa: F401
        from openai import DefaultAioHttpClient  # noqa: F401
    except ImportError:
        raise UsageError(
            "an endpoint needs the openai client; install it with `pip install 'envcraft-rl[llm]'`"
        ) from None


def redacted_address(address: str) -> str:
    """Return an address without its credentials and its query."""
    try:
        parts = urlsplit(address)
    except ValueError:
        return "the address of --base-url"
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"


def _client(settings: ModelSettings, key: str) -> AsyncOpenAI:
    from openai import DEFAULT_CONNECTION_LIMITS, AsyncOpenAI, DefaultAioHttpClient, Timeout

    # The class comes from the library below the client, which depends on the client's version.
    limits = type(DEFAULT_CONNECTION_LIMITS)
    connections = settings.max_concurrency + _SPARE_CONNECTIONS
    _raise_file_limit(connections)
    return AsyncOpenAI(
        base_url=settings.base_url,
        # The client requires a key; local endpoints rarely check it.
        api_key=key or "none",
        # Retries happen here, where the concurrency limit is known.
        max_retries=0,
        timeout=Timeout(None, connect=settings.connect_seconds),
        # Its cost per request does not grow with the number of connections.
        http_client=DefaultAioHttpClient(
            limits=limits(max_connections=connections, max_keepalive_connections=connections)
        ),
    )


def _raise_file_limit(connections: int) -> None:
    """Raise the limit of open files of this process, as far as the system allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = connections + _SPARE_FILES
    if soft != resource.RLIM_INFINITY and soft < wanted:
        limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, limit), hard))
