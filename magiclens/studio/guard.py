"""Who may talk to the studio: the browser that has its token, on a page of its own, by its own address."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; img-src 'self' blob: data:; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
RUN_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' blob: data:; "
    "media-src 'self' blob: data:; connect-src blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
"""Content security policy for files of runs: their pages work, within the studio's page, too, and can ask the studio
for nothing but pictures."""
_HEADERS = {
    "content-security-policy": _PAGE_POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}


@dataclass(frozen=True)
class Door:
    """What a request must bring.

    Attributes:
        port: The port on 127.0.0.1.
        origins: Further origins, such as that of a reverse proxy: ``https://studio.example.org``.
        token: The secret that is in the address which the terminal shows.
    """

    port: int
    origins: Sequence[str] = ()
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))

    @property
    def cookie(self) -> str:
        """The cookie's name; browsers do not tell ports apart."""
        return f"mlens-studio-{self.port}"

    @property
    def address(self) -> str:
        """The address to open."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def refusal(self, request: Request) -> str | None:
        """Why a request is refused; None if it may pass."""
        own = [f"http://127.0.0.1:{self.port}", f"http://localhost:{self.port}", *self.origins]
        origin, safe = request.headers.get("origin"), request.method in ("GET", "HEAD")
        if request.headers.get("host") not in {urlsplit(each).netloc for each in own}:
            return "this is not the studio's address"
        if origin not in own and not (safe and origin is None):
            return "this comes from another page"
        if not self._known(request.cookies.get(self.cookie)) and not self._arrives(request):
            return "open the address that 'mlens studio' shows in the terminal; it has the token"
        return None

    def enter(self, request: Request, response: Response) -> None:
        """Let a browser that brings the token keep it as a cookie."""
        if self._arrives(request):
            response.set_cookie(self.cookie, self.token, httponly=True, samesite="strict", path="/")

    def _arrives(self, request: Request) -> bool:
        return request.method == "GET" and request.url.path == "/" and self._known(request.query_params.get("token"))

    def _known(self, token: str | None) -> bool:
        return token is not None and secrets.compare_digest(token.encode(), self.token.encode())


class Guard:
    """Refuses requests that the door does not let in, and gives every answer the headers that keep it to itself."""

    def __init__(self, app: ASGIApp, door: Door):
        self._app, self._door = app, door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it with 403; as ASGI has it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        refusal = self._door.refusal(Request(scope)) if scope["type"] == "http" else "only HTTP is spoken here"
        app = PlainTextResponse(f"{refusal}\n", 403) if refusal else self._app
        await app(scope, receive, send_guarded)
