"""Who may talk to the page: a program on this machine, or one that knows the token.

A foreign web page in the same browser can reach 127.0.0.1 too, under a name of its own (DNS rebinding) or by sending
forms: so Host must be this machine's name, Origin this page's, and what writes must come as JSON, which no form sends.
"""

import hmac
import json
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

LOOPBACK = ("127.0.0.1", "localhost", "::1")
COOKIE = "scene2skill"
HEADERS = {
    "content-security-policy": "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}


class Guard:
    """ASGI middleware. hosts: names that Host may have, None for any. token: what a browser must show, None for none."""

    def __init__(self, app, hosts=LOOPBACK, token: str | None = None, max_body: int = 2**20):
        self.app, self.hosts, self.token, self.max_body = app, hosts, token, max_body

    async def __call__(self, scope, receive, send):
        if scope["type"] == "lifespan":
            return await self.app(scope, receive, send)
        headers = {name.decode("latin1"): value.decode("latin1") for name, value in scope["headers"]}
        refusal = self._refusal(scope, headers)
        if refusal and scope["type"] == "websocket":
            return await send({"type": "websocket.close", "code": 4003, "reason": refusal[1]})
        if refusal:
            return await _answer(send, *refusal)
        if scope["type"] == "websocket":
            return await self.app(scope, receive, send)
        await self.app(scope, receive, self._with_headers(scope, send))

    def _refusal(self, scope, headers) -> tuple[int, str, str] | None:
        """Status, sentence and the field at fault."""
        host = headers.get("host", "")
        if self.hosts is not None and _hostname(host) not in self.hosts:
            return 403, f"Host is {host[:60]!r}: open the page by the address that it printed", "Host"
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2] != host:
            return 403, f"Origin is {origin[:60]!r}: another web page may not use this one", "Origin"
        if self.token and not (_equal(_cookie(headers), self.token) or _equal(_query(scope), self.token)):
            return 403, "open the page by the address with the token that it printed", "token"
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD"):
            return self._refused_body(scope, headers)
        return None

    def _refused_body(self, scope, headers):
        if not headers.get("content-type", "").startswith("application/json"):
            return 415, "Content-Type must be application/json", "Content-Type"
        length = headers.get("content-length", "")
        if not length.isascii() or not length.isdigit():
            return 411, "Content-Length is missing", "Content-Length"
        if int(length[:20]) > self.max_body:
            return 413, f"the body has {length[:20]} bytes: at most {self.max_body} are allowed", "Content-Length"
        return None

    def _with_headers(self, scope, send):
        async def sending(message):
            if message["type"] == "http.response.start":
                more = dict(HEADERS)
                if self.token and _equal(_query(scope), self.token):
                    more["set-cookie"] = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
                message["headers"] = [*message["headers"], *((k.encode(), v.encode()) for k, v in more.items())]
            await send(message)

        return sending


def _hostname(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _cookie(headers) -> str:
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return cookie.value if cookie else ""


def _query(scope) -> str:
    return parse_qs(scope["query_string"].decode("latin1")).get("token", [""])[0]


def _equal(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


async def _answer(send, status: int, error: str, field: str) -> None:
    body = json.dumps({"error": error, "field": field}).encode()
    headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode()), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
