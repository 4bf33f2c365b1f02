"""Who may use the server: requests to this machine, from its own pages, with its token.

A page of another site can send requests to the loopback interface, and a name that resolves to 127.0.0.1 lets it read
the answers. So the server accepts only its own names as Host, only itself as Origin, and only the token that the
command printed.
"""

from __future__ import annotations

import secrets
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers, QueryParams
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_HEADERS = {
    "content-security-policy": "default-src 'none'; img-src 'self' data:; style-src 'self'; script-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
_NAMES = ("127.0.0.1", "localhost")
#: The WebSocket close code for a violated policy (RFC 6455).
_VIOLATION = 1008


class Guard:
    """ASGI middleware that lets only the user's own pages through, and adds the security headers.

    Args:
        app: the application.
        port: of the server.
        token: the secret; a random one by default.

    Attributes:
        token: the secret.
    """

    def __init__(self, app: ASGIApp, port: int, token: str | None = None) -> None:
        self._app, self._hosts = app, [f"{name}:{port}" for name in _NAMES]
        self._cookie = f"envcraft-{port}"
        self.token = token or secrets.token_urlsafe(32)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(headers)
        given = QueryParams(scope["query_string"]).get("token", "") if scope["type"] == "http" else ""
        if refusal is None and self._right(given):
            # The address without the token is the one that people copy.
            response: Response = RedirectResponse(scope["path"], HTTPStatus.SEE_OTHER)
            response.set_cookie(self._cookie, self.token, path="/", httponly=True, samesite="strict")
            await response(scope, receive, self._with_headers(send))
        elif refusal is None and self._right(self._known(headers)):
            await self._app(scope, receive, self._with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": _VIOLATION, "reason": refusal or "the token is missing"})
        else:
            words = refusal or "Open the address that `envcraft explore` printed: it has the token of this server."
            response = PlainTextResponse(f"{words}\n", HTTPStatus.FORBIDDEN)
            await response(scope, receive, self._with_headers(send))

    def _refusal(self, headers: Headers) -> str | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if host not in self._hosts:
            return f"This server answers to {self._hosts[0]} only."
        if origin is not None and origin != f"http://{host}":
            return "This server answers to its own pages only."
        return None

    def _right(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())

    def _known(self, headers: Headers) -> str:
        """The token in the cookie; empty if there is none."""
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return ""
        return cookies[self._cookie].value if self._cookie in cookies else ""

    def _with_headers(self, send: Send) -> Send:
        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                known = {name for name, _ in message["headers"]}
                added = [(name.encode(), value.encode()) for name, value in _HEADERS.items()]
                message["headers"] = [*message["headers"], *(item for item in added if item[0] not in known)]
            await send(message)

        return sent
