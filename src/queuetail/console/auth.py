"""Who may do what: a token per role outside loopback, and no tricks through other web sites."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from dataclasses import dataclass
from enum import StrEnum
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN_BYTES = 24  # 192 bits: no number of guesses finds it
SAFE_METHODS = {"GET", "HEAD", "OPTIONS"}
NICEGUI_SOCKET = "/_nicegui_ws/"  # carries the page itself; each page checks the role
PAGE_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self'; object-src 'none'; base-uri 'self'; form-action 'self'; "
    "frame-ancestors 'none'"
)
SECURITY_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"content-security-policy", PAGE_POLICY.encode()),
)


class Role(StrEnum):
    """What a visitor may do: look, or also change settings."""

    VIEWER = "viewer"
    OPERATOR = "operator"


@dataclass(frozen=True, slots=True)
class Access:
    """The tokens of a console; without any, everybody on this machine is the operator."""

    viewer: str = ""
    operator: str = ""

    @property
    def is_open(self) -> bool:
        """Whether no token is asked for."""
        return not self.operator

    def role(self, token: str) -> Role | None:
        """Return the role that a token gives, compared in constant time."""
        if self.is_open:
            return Role.OPERATOR
        given = token.encode()
        # Both are compared always, so that the time tells nothing of either.
        is_operator = hmac.compare_digest(given, self.operator.encode())
        is_viewer = hmac.compare_digest(given, self.viewer.encode())
        if is_operator:
            return Role.OPERATOR
        return Role.VIEWER if is_viewer else None


def access_for(host: str) -> Access:
    """Return new random tokens for an address that others can reach; none for loopback."""
    if is_loopback(host):
        return Access()
    return Access(secrets.token_urlsafe(TOKEN_BYTES), secrets.token_urlsafe(TOKEN_BYTES))


def is_loopback(host: str) -> bool:
    """Tell whether only this machine can reach an address."""
    name = host.strip("[]")
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return name == "localhost"


def role_of(connection: HTTPConnection) -> Role:
    """Return the role that the guard gave to a request or a WebSocket."""
    return Role(connection.scope["state"]["role"])


class Guard:
    """Lets only those in who have a token, and only requests that no other site made them send."""

    def __init__(self, app: ASGIApp, access: Access, cookie: str) -> None:
        """`cookie` is the name under which a browser keeps its token."""
        self._app, self._access, self._cookie = app, access, cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Judge one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 4401, "reason": "not allowed"})
            else:
                await refusal(scope, receive, self._secured(send))
            return
        await self._app(scope, receive, self._secured(send))

    def _refusal(self, scope: Scope, headers: Headers) -> Response | None:
        """Return what to answer instead of the page; None, and the role in the scope, if well."""
        if (sentence := self._foreign(headers)) is not None:
            return refused(403, sentence)
        query = scope.get("query_string", b"").decode("latin-1")
        asked = dict(parse_qsl(query)).get("token", "")
        token = bearer(headers) or asked or self._cookie_token(headers)
        role = self._access.role(token)
        if role is None:
            wanted = "open the address that was printed at the start: it has the token"
            return refused(401, wanted, "text/html" in headers.get("accept", ""))
        scope.setdefault("state", {})["role"] = role.value
        method = scope.get("method", "GET")  # a WebSocket has none: its route judges the role
        changes = method not in SAFE_METHODS and not scope["path"].startswith(NICEGUI_SOCKET)
        if changes and role is Role.VIEWER:
            return refused(403, "a viewer may look, and change nothing")
        if asked and not self._access.is_open and scope["type"] == "http" and method == "GET":
            return self._welcome(scope["path"], query, token)
        return None

    def _foreign(self, headers: Headers) -> str | None:
        """Say what is wrong with a request that another web site made the browser send."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if self._access.is_open and not is_loopback(hostname(host)):
            return "open the console as http://127.0.0.1 on this machine"
        if origin is not None and origin.partition("://")[2] != host:
            return "another site may not send requests to the console"
        return None

    def _welcome(self, path: str, query: str, token: str) -> Response:
        """Keep the token in a cookie, and go on to the page without it in the address.

        A page of our own goes on, as a redirect from another app would not bring a strict cookie.
        """
        rest = urlencode([(k, v) for k, v in parse_qsl(query) if k != "token"])
        goal = "/" + path.lstrip("/\\") + (f"?{rest}" if rest else "")
        page = HTMLResponse(
            f'<!doctype html><html lang="en"><title>queuetail</title>'
            f'<meta http-equiv="refresh" content="0;url={escaped(goal)}">'
            f'<p><a href="{escaped(goal)}">To the console</a></p></html>',
            headers={"Cache-Control": "no-store"},
        )
        page.set_cookie(self._cookie, token, httponly=True, samesite="strict", path="/")
        return page

    def _cookie_token(self, headers: Headers) -> str:
        try:
            jar = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return ""
        morsel = jar.get(self._cookie)
        return morsel.value if morsel is not None else ""

    def _secured(self, send: Send) -> Send:
        async def sender(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *SECURITY_HEADERS]
            await send(message)

        return sender


def bearer(headers: Headers) -> str:
    """Return the token that a program sends in its headers."""
    kind, _, token = headers.get("authorization", "").partition(" ")
    return token.strip() if kind.lower() == "bearer" else ""


def hostname(host: str) -> str:
    """Return a Host header without its port; empty where it is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def refused(status: int, sentence: str, html: bool = False) -> Response:
    """Return a refusal with one sentence."""
    if html:
        page = f'<!doctype html><html lang="en"><title>queuetail</title><p>{sentence}</p></html>'
        return HTMLResponse(page, status)
    return JSONResponse({"detail": sentence}, status)


def escaped(text: str) -> str:
    """Return text for an attribute of HTML."""
    for plain, entity in (("&", "&amp;"), ('"', "&quot;"), ("'", "&#39;"), ("<", "&lt;")):
        text = text.replace(plain, entity)
    return text
