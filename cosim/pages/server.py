"""Server of growing pages on this machine alone, at an address that cannot be guessed."""

import json
import secrets
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from time import monotonic
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from ..errors import CosimError, one_line
from .watched import GrowingPage

HOST: Final = "127.0.0.1"
_HEADERS: Final = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}


class PageServer(ThreadingHTTPServer):
    """Server of the pages of runs. It answers requests that name this machine and the token, and no others."""

    daemon_threads = True

    def __init__(self, pages: Mapping[str, GrowingPage]) -> None:
        """pages: by path, the first page as the empty text. Raises OSError."""
        super().__init__((HOST, 0), _Handler)
        self.pages = pages
        self.token = secrets.token_urlsafe(24)
        self.asked_at = monotonic()
        """Time of the newest request [s]."""
        self.is_told = False
        """True where a page says that its runs have ended and that it has all of them."""

    @property
    def address(self) -> str:
        """Address of the first page."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    def serve(self) -> None:
        """Answer requests until KeyboardInterrupt."""
        try:
            self.serve_forever(poll_interval=0.2)
        finally:
            self.server_close()

    def serve_until_end(self, is_over: Any, patience: float) -> None:
        """Answer requests until a page has all to the end, or is_over() and nobody has asked for patience [s]."""
        thread = threading.Thread(target=self.serve, daemon=True)
        thread.start()
        try:
            pause = threading.Event()
            while not (self.is_told or (monotonic() - self.asked_at > patience and is_over())):
                pause.wait(0.2)
            pause.wait(0.5)  # until the answer has left
        finally:
            self.shutdown()
            thread.join()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that has gone."""


class _Handler(BaseHTTPRequestHandler):
    """Answer to one request."""

    server: PageServer  # pyright: ignore[reportIncompatibleVariableOverride]
    timeout = 30

    def do_GET(self) -> None:
        """Answer with a page or with what is new in it; with 404 to whoever does not know the token."""
        asked = urlsplit(self.path)
        token, _, rest = asked.path.lstrip("/").partition("/")
        page = self.server.pages.get(rest.removesuffix("data").rstrip("/"))
        if page is None or not self._is_welcome(token):
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", "there is no such page")
            return
        self.server.asked_at = monotonic()
        try:
            if rest.rpartition("/")[2] != "data":
                self._answer(HTTPStatus.OK, "text/html", page.html())
                return
            query = parse_qs(asked.query)
            news = page.news(query.get("since", [""])[0])
            self._answer(HTTPStatus.OK, "application/json", json.dumps(news, allow_nan=False))
            self.server.is_told |= "has" in query
        except CosimError as e:
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, "text/plain", one_line(str(e)))

    def _is_welcome(self, token: str) -> bool:
        """Return whether a request has the token, and names this machine: a page elsewhere may rebind a name to it."""
        names = (f"{HOST}:{self.server.server_port}", f"localhost:{self.server.server_port}")
        return self.headers.get("Host") in names and secrets.compare_digest(token.encode(), self.server.token.encode())

    def _answer(self, status: HTTPStatus, kind: str, text: str) -> None:
        content = text.encode()
        self.send_response(status)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: the address is a secret."""

    def version_string(self) -> str:
        """Return the name of the server."""
        return "fmu-retune"
