"""The server of the page, and its gate: who may connect, and which messages may enter.

A websocket accepts connections from every page that the browser shows. The gate asks for the page's
own Host and Origin and for the token in the page's address, and it passes on a message only if the
page offers what the message asks for.
"""

import ipaddress
import json
import logging
import secrets
import socket
from base64 import b64encode
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from http import HTTPStatus
from pathlib import Path
from threading import Condition, Lock, Thread
from typing import Any
from urllib.parse import urlsplit

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from periscopy_sim.errors import PeriscopyError

LOG = logging.getLogger(__name__)
QUIET = LOG.getChild("connections")  # would show the traceback of each that fails
QUIET.setLevel(logging.CRITICAL + 1)

LARGEST = 2**14
"""Bytes of a message; those of the page have some 100."""

SCRIPT = Path(__file__).with_name("page.js").read_bytes()
PAGE = Path(__file__).with_name("page.html").read_bytes().replace(b"page.js", SCRIPT)

POLICY = (
    f"default-src 'none'; script-src 'sha256-{b64encode(sha256(SCRIPT).digest()).decode()}'; "
    "style-src 'unsafe-inline'; img-src data:; connect-src 'self'; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'"
)
"""The page's own script alone runs, and no other page may frame it."""


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens; port 0 takes a free one.

    A PeriscopyError says that the port is taken, or the address is none of this computer.
    """
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address, family=family)
    except (OSError, UnicodeError) as error:
        raise PeriscopyError(
            f"cannot listen on {host}:{port}: {error}; name another port or host"
        ) from None


class Gate:
    """The server of a page: a listening socket, a token, and the state that all viewers see.

    It listens as `listen` does. `receive` takes a message of a viewer, decoded, and raises a
    ValueError if the page offers nothing like it; one message at a time, in a thread of each
    viewer. The server serves the page alone, at every path that begins with `token`;
    `rejected` counts connections and messages, which the log names. `is_open` says whether other
    computers can connect.
    """

    def __init__(self, host: str, port: int, receive: Callable[[Any], None]) -> None:
        self._host, self.token = host, secrets.token_urlsafe(16)
        self._receive, self._receiving, self.rejected = receive, Lock(), 0
        self._socket = listen(host, port)
        bound, self.port, *_ = self._socket.getsockname()
        self._address = ipaddress.ip_address(bound)
        self.is_open = not self._address.is_loopback
        self._state: dict[str, tuple[int, str]] = {}  # by name: when it changed, and as JSON
        self._changes, self._changed, self._is_closed = 0, Condition(), False
        self._server = serve(
            self._attend, sock=self._socket, process_request=self._answer, max_size=LARGEST,
            compression=None, logger=QUIET,
        )  # fmt: skip
        self._thread = Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """The address of the page, with its token; of all of a computer's one that others reach."""
        host = self._host
        if self._address.is_unspecified:
            host, far = socket.gethostname(), {4: "192.0.2.1", 6: "2001:db8::1"}
            probe = socket.socket(self._socket.family, socket.SOCK_DGRAM)
            with probe, suppress(OSError):  # no network
                probe.connect((far[self._address.version], 9))  # chooses a route, sends nothing
                host = probe.getsockname()[0]
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/{self.token}/"

    def publish(self, **state: Any) -> None:
        """Show all viewers parts of the state, by name, in one message.

        A viewer who is slow gets the latest of each part, and none that is out of date.
        """
        parts = {name: json.dumps(each) for name, each in state.items()}
        with self._changed:
            self._changes += 1
            self._state |= {name: (self._changes, text) for name, text in parts.items()}
            self._changed.notify_all()

    def close(self) -> None:
        """End the page for all viewers."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._server.shutdown()
        self._thread.join()

    # -- in the server's threads -------------------------------------------------------------------

    def _attend(self, viewer: ServerConnection) -> None:
        Thread(target=self._send_news, args=(viewer,), daemon=True).start()
        for message in viewer:
            try:
                with self._receiving:
                    self._receive(json.loads(message))
            except (ValueError, RecursionError) as error:
                self._reject(f"a message that no control sends: {error}")

    def _send_news(self, viewer: ServerConnection) -> None:
        sent = 0
        with suppress(ConnectionClosed):
            while not self._is_closed:
                with self._changed:
                    while self._changes == sent and not self._is_closed:
                        self._changed.wait()
                    news = {name: text for name, (when, text) in self._state.items() if when > sent}
                    sent = self._changes
                members = (f"{json.dumps(name)}:{text}" for name, text in news.items())
                viewer.send(f"{{{','.join(members)}}}")
        viewer.close()

    def _answer(self, viewer: ServerConnection, request: Request) -> Response | None:
        """Answer an HTTP request; None lets a websocket in."""
        if fault := self._fault_of_request(request):
            self._reject(fault)
            return viewer.respond(HTTPStatus.FORBIDDEN, f"{fault}\n")
        if "Upgrade" in request.headers:
            return None
        headers = Headers({
            "Content-Type": "text/html; charset=utf-8", "Content-Length": str(len(PAGE)),
            "Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer", "Cache-Control": "no-store", "Connection": "close",
        })  # fmt: skip
        return Response(HTTPStatus.OK, "OK", headers, PAGE)

    def _fault_of_request(self, request: Request) -> str:
        """Return why a request is not one of the page; empty if it is."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            return "the request names another host"
        # A page that is opened has no origin yet; a websocket always has that of its page.
        if origins != [f"http://{hosts[0]}"] and (origins or "Upgrade" in request.headers):
            return "the request comes from another page"
        first = request.path.partition("?")[0].removeprefix("/").partition("/")[0]
        if not secrets.compare_digest(first.encode(), self.token.encode()):
            return "the address lacks the token that the command printed"
        return ""

    def _is_own(self, host: str) -> bool:
        """Return whether a Host is this computer's: its name or an address, not another's name."""
        with suppress(ValueError):
            name = urlsplit(f"//{host}").hostname or ""
            own = {"localhost", self._host.lower(), socket.gethostname().lower()}
            return name in own or bool(ipaddress.ip_address(name).packed)
        return False

    def _reject(self, fault: str) -> None:
        with self._receiving:
            self.rejected += 1
        LOG.info("the page dropped %.200s", ascii(fault))
