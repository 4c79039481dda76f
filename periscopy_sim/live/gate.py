"""The gate of the page: who may connect to its server, and which messages may enter.

A websocket accepts connections from every page that the browser shows, and viser applies whatever
a client sends. The gate stands before both: it asks for the page's own Host and Origin and for the
token in the page's address, and it passes on a message only if a control of the page can send it.
Rejections are logged, at most one line a second.
"""

import contextlib
import ipaddress
import logging
import secrets
import socket
import time
from collections.abc import Iterator, Sequence
from http import HTTPStatus
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

import msgspec
import websockets.asyncio.server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from periscopy_sim.errors import PeriscopyError

LOG = logging.getLogger(__name__)

LARGEST = 2**14
"""Bytes of a message; those of the page have some 300."""

Number = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
"""A finite number, as a camera or a handle has them."""

Place = tuple[Number, Number, Number]

_NAME = [("name", str), ("owner", str)]
_POSE = [("wxyz", tuple[Number, Number, Number, Number]), ("position", Place)]
_LOOK = [("look_at", Place), ("up_direction", Place)]
_LENS = [(name, Number) for name in ("fov", "near", "far", "image_height", "image_width")]

MESSAGES: dict[str, Any] = {
    name: msgspec.defstruct(name, fields, forbid_unknown_fields=True)
    for name, fields in (
        ("GuiUpdateMessage", [("uuid", str), ("updates", dict[Literal["value"], Any])]),
        ("TransformControlsDragStartMessage", _NAME),
        ("TransformControlsUpdateMessage", _NAME + _POSE),
        ("TransformControlsDragEndMessage", _NAME),
        ("ViewerCameraMessage", _POSE + _LOOK + _LENS),
    )
}
"""The messages that the page sends, by viser's names, and their fields."""


class Gate:
    """A listening socket, the token of its page, and the values that the page's controls offer.

    Port 0 takes a free one. `token` begins every path that the server serves, `rejected` counts
    connections and messages. A PeriscopyError says that the port is taken, or the address is none
    of this computer.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host, self.token = host, secrets.token_urlsafe(16)
        self._offered: dict[str, Any] = {}
        self.rejected, self._logged, self._last_line = 0, 0, -1.0
        try:
            family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            self._socket = socket.create_server(address, family=family)
        except (OSError, UnicodeError) as error:
            raise PeriscopyError(
                f"cannot listen on {host}:{port}: {error}; name another port or host"
            ) from None
        bound, self.port, *_ = self._socket.getsockname()
        self._address = ipaddress.ip_address(bound)

    @property
    def url(self) -> str:
        """The address of the page, with its token; of all of a computer's one that others reach."""
        host = self._host
        if self._address.is_unspecified:
            host, far = socket.gethostname(), {4: "192.0.2.1", 6: "2001:db8::1"}
            probe = socket.socket(self._socket.family, socket.SOCK_DGRAM)
            with probe, contextlib.suppress(OSError):  # no network
                probe.connect((far[self._address.version], 9))  # chooses a route, sends nothing
                host = probe.getsockname()[0]
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/{self.token}/"

    @property
    def is_open(self) -> bool:
        """Whether other computers can connect."""
        return not self._address.is_loopback

    def offer_names(self, control: str, names: Sequence[str]) -> None:
        """Accept one of some names from a control; the control "handle" is all handles."""
        self._offered[control] = Literal[tuple(names)]

    def offer_values(self, control: str, ends: tuple[float, float] | None = None) -> None:
        """Accept numbers from one end to the other from a control, or true and false."""
        within = ends and Annotated[float, msgspec.Meta(ge=ends[0], le=ends[1])]
        self._offered[control] = within or bool

    @contextlib.contextmanager
    def guarding(self) -> Iterator[None]:
        """Let the viser server that is made in this context serve behind the gate.

        A RuntimeError says that no server did, and that it may serve without it.
        """
        gate, original, is_guarded = self, websockets_server.serve, False
        quiet = LOG.getChild("connections")  # would show the traceback of each that fails
        quiet.setLevel(logging.CRITICAL + 1)

        class Guarded(ServerConnection):
            async def recv(self, decode: bool | None = None) -> Any:
                while True:
                    message = await super().recv(decode)
                    if not (fault := gate.fault_of(message)):
                        return message
                    gate.reject(fault)

        def serve(handler: Any, *_: Any, **options: Any) -> Any:
            nonlocal is_guarded
            is_guarded = True
            answer = options["process_request"]

            def process(connection: ServerConnection, request: Request) -> Response | None:
                if fault := gate.fault_of_request(request):
                    gate.reject(fault)
                    return connection.respond(HTTPStatus.FORBIDDEN, f"{fault}\n")
                request.path = request.path.removeprefix(f"/{gate.token}") or "/"
                response: Response | None = answer(connection, request)
                return response

            options |= {
                "process_request": process, "create_connection": Guarded, "max_size": LARGEST,
                "logger": quiet, "sock": gate._socket,
            }  # fmt: skip
            return original(handler, **options)

        websockets_server.serve = serve  # type: ignore[assignment,misc]
        try:
            yield
        finally:
            websockets_server.serve = original  # type: ignore[misc]
        if not is_guarded:
            raise RuntimeError("this version of viser does not serve through websockets' serve")

    def fault_of_request(self, request: Request) -> str:
        """Return why a request is not one of the page; empty if it is."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            return "the request names another host"
        # A page that is opened has no origin yet; a websocket always has that of its page.
        if origins != [f"http://{hosts[0]}"] and (origins or "Upgrade" in request.headers):
            return "the request comes from another page"
        token = request.path.partition("?")[0].split("/")[1:2]
        if not token or not secrets.compare_digest(token[0].encode(), self.token.encode()):
            return "the address lacks the token that `periscopy view` printed"
        return ""

    def _is_own(self, host: str) -> bool:
        """Return whether a Host is this computer's: its name or an address, not another's name."""
        with contextlib.suppress(ValueError):
            name = urlsplit(f"//{host}").hostname or ""
            own = {"localhost", self._host.lower(), socket.gethostname().lower()}
            return name in own or bool(ipaddress.ip_address(name).packed)
        return False

    def fault_of(self, message: bytes | str) -> str:
        """Return what of a message no control of the page offers; empty if one does."""
        if isinstance(message, str):
            return "a text message"
        try:
            fields = msgspec.msgpack.decode(message, type=dict[str, Any])
            sent = msgspec.convert(fields, MESSAGES[fields.pop("type")])
            if hasattr(sent, "uuid"):
                msgspec.convert(sent.updates["value"], self._offered[sent.uuid])
            elif hasattr(sent, "name"):
                msgspec.convert(sent.name, self._offered["handle"])
        except (msgspec.MsgspecError, LookupError, TypeError, ValueError, RecursionError) as error:
            return f"a message that no control sends: {error}"
        return ""

    def reject(self, fault: str) -> None:
        """Log a rejection, and how many others since the last line, which is a second old."""
        self.rejected += 1
        if time.monotonic() - self._last_line >= 1:
            others = self.rejected - self._logged - 1
            more = f" and {others} others" if others else ""
            LOG.warning("periscopy view dropped %.200s%s", ascii(fault), more)
            self._logged, self._last_line = self.rejected, time.monotonic()
