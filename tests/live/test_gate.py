"""The page's server as an attacker meets it: pages of others, and clients that send anything."""

import json
import socket
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from html.parser import HTMLParser
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest

from periscopy_sim.live import gate
from periscopy_sim.live.level import Choice
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.rendering.scene.load import load_scenario

viser = pytest.importorskip("viser")
msgspec = pytest.importorskip("msgspec")
websockets = pytest.importorskip("websockets")
zstandard = pytest.importorskip("zstandard")
from websockets.http11 import Headers, Request  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

PHOTOGRAPH, HIDDEN = (24, 24), (6, 8)
PATIENCE = 240.0  # another process may be compiling, on a busy machine
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1, 0, 0, 0), "position": (0, 0, 1.5),
    "look_at": (0, 1, 0), "up_direction": (0, 0, 1), "fov": 1.0, "near": 0.01, "far": 1000,
    "image_height": 600, "image_width": 800,
}  # fmt: skip

HOSTILE = (
    '<iframe srcdoc="<script>f()</script>"></iframe></div><img src=x onerror=f()> &lt;b&gt; '
    "![a](icon.png) [b](javascript:f) **c** `d` \\* $e$ www.example.org"
)
"""What an id, a name, a value or a message may hold."""


class Target:
    """A session that runs, what it has shown, and what an attacker knows of it."""

    def __init__(self, session):
        self.shown, self.saved = session.shown, session.saved
        self.page, self.gate = session.page, session.page.gate
        self.origin = f"http://127.0.0.1:{self.gate.port}"

    @contextmanager
    def client(self, token=None, origin=None, host=None):
        """Connect as a page would; without arguments as the page itself."""
        host = host or f"127.0.0.1:{self.gate.port}"
        token = self.gate.token if token is None else token
        with (
            socket.create_connection(("127.0.0.1", self.gate.port)) as sock,
            connect(
                f"ws://{host}/{token}", sock=sock, origin=origin or self.origin,
                subprotocols=[f"viser-v{viser.__version__}"], max_size=None,
            ) as client,
        ):  # fmt: skip
            before = set(self.page.server.get_clients())
            send(client, CAMERA)  # viser heeds a client that has a camera
            self.until(lambda: set(self.page.server.get_clients()) - before)
            yield client

    def messages(self):
        """Return all that the page's server tells a new client."""
        messages = []
        with self.client() as client:
            while not messages or messages[-1]["type"] != "ReplayDoneMessage":
                raw = client.recv(PATIENCE)
                packed = raw[16 : 16 + int.from_bytes(raw[8:16], "little")]
                messages += msgspec.msgpack.decode(zstandard.decompress(packed))["messages"]
        return messages

    @cached_property
    def controls(self):
        """The names that the page's client gives to controls, by their labels."""
        controls = (each for each in self.messages() if "label" in (each.get("props") or {}))
        return {each["props"]["label"]: each["uuid"] for each in controls}

    def control(self, label):
        return self.controls[label]

    def until(self, holds):
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end
            time.sleep(0.01)

    def goes_on(self):
        """Show that a new wish of the page itself is granted."""
        snr = 30.0 if self.page.choice.snr != 30 else 40.0
        with self.client() as client:
            send(client, value_of(self.control("SNR (dB)"), snr))
            self.until(lambda: self.shown and self.shown[-1].choice.snr == snr)


def send(client, message):
    client.send(message if isinstance(message, str) else msgspec.msgpack.encode(message))


def value_of(uuid, value):
    return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}


@pytest.fixture(scope="module")
def target(running):
    scenario = load_scenario("plate", HIDDEN, photograph=PHOTOGRAPH)
    first, light = Choice({}, "mushroom", "overcast"), np.ones((*PHOTOGRAPH, 3))
    with running(scenario, first, [HOSTILE], light) as session:
        made = Target(session)
        made.until(lambda: made.shown)
        yield made


def test_no_text_of_the_page_is_markup(target):
    """All that the client takes for markup, as it comes over the wire."""
    target.until(lambda: not target.shown[-1].is_coarse)
    pictures = target.shown[-1]
    choice = replace(pictures.choice, method=HOSTILE)
    target.page.show(replace(pictures, choice=choice, report=Report()))
    target.page.tell(f"failed: {HOSTILE}")
    messages = target.messages()
    assert not {"GuiMarkdownMessage", "GuiModalMessage"} & {each["type"] for each in messages}
    tags, texts, parser = set(), [], HTMLParser()
    parser.handle_starttag, parser.handle_data = lambda tag, _: tags.add(tag), texts.append
    for each in messages:
        parser.feed((each.get("props") or each.get("updates") or {}).get("content", ""))
    assert tags == {"div"}
    assert {HOSTILE, f"Standard error: {HOSTILE} reports none", f"failed: {HOSTILE}"} <= {*texts}


@pytest.mark.parametrize(
    "foreign",
    [
        {"origin": "http://evil.example"},
        {"origin": "http://127.0.0.1:1"},
        {"origin": "null"},
        {"host": "evil.example", "origin": "http://evil.example"},
        {"token": "guessed"},
        {"token": ""},
        {"token": "\u00fc"},
    ],
)
def test_pages_of_others_cannot_connect(target, foreign):
    before = target.gate.rejected
    with pytest.raises(websockets.InvalidStatus) as refused, target.client(**foreign):
        pass
    assert refused.value.response.status_code == 403
    assert target.gate.rejected == before + 1
    target.goes_on()


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}])
def test_pages_of_others_cannot_read_the_page(target, headers):
    for url in (target.gate.url, target.origin):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(urllib.request.Request(url, headers=headers))
        assert refused.value.code == 403
        refused.value.close()
    with urllib.request.urlopen(target.gate.url) as page:
        assert b"<html" in page.read()


def test_only_values_that_a_control_offers_are_accepted(target, tmp_path):
    own = tmp_path / "own.py"
    own.write_text(f"open({str(tmp_path / 'executed')!r}, 'w')\n")
    picture = tmp_path / "private.png"
    picture.write_bytes(b"")
    before, rejected = target.page.choice, target.gate.rejected
    method, image = target.control("Method"), target.control("Hidden image")
    snr, place = target.control("SNR (dB)"), target.control("Ambient light")
    write = target.control("Write scene and pictures")
    handle = {"name": "/handles/plate", "owner": ""}
    pose = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 0.0)}
    drag = {"type": "TransformControlsUpdateMessage"} | handle | pose
    nan = float("nan")
    attacks = [
        *(value_of(method, each) for each in (f"{own}:run", "file.py", "iterative", "", None, [])),
        *(value_of(image, each) for each in (str(picture), "a" * 5000, "not known", {})),
        *(value_of(place, each) for each in ("window", str(tmp_path / "x.xml"), 1)),
        *(value_of(snr, each) for each in (-10_000, nan, 1e300, "60", True, None)),
        *(value_of("nobody", each) for each in (1, "noise-aware")),
        value_of(write, {"value": 1}),
        value_of(method, "noise-aware") | {"updates": {"value": "noise-aware", "options": []}},
        value_of(method, "noise-aware") | {"updates": {"update_cb": []}},
        value_of(method, "noise-aware") | {"updates": {}},
        drag | {"position": (nan, 0.0, 0.0)},
        drag | {"position": (float("inf"), 0.0, 0.0)},
        drag | {"position": (0.0,)},
        drag | {"name": "/handles/none"},
        {"type": "ShareUrlRequest"},
        {"type": "RunJavascriptMessage", "source": "1"},
        {"type": "ViewerCameraMessage"},
        {"type": "Nothing"},
        {},
        [1, 2],
        json.dumps({"type": "ShareUrlRequest"}),
    ]
    with target.client() as client:
        for attack in attacks:
            send(client, attack)
        target.until(lambda: target.gate.rejected >= rejected + len(attacks))
    assert target.gate.rejected == rejected + len(attacks)
    assert target.page.choice == before
    assert not (tmp_path / "executed").exists() and not target.saved
    target.goes_on()


def test_rejections_leave_a_line_a_second(caplog, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(gate, "time", SimpleNamespace(monotonic=lambda: now[0]))
    guard = gate.Gate("127.0.0.1", 0)
    guard._socket.close()
    for _ in range(1000):
        guard.reject("\x1b[2J" + 300 * "x")
    now[0] += 1.0
    guard.reject("another host")
    first, second = caplog.messages
    assert first.isprintable() and len(first) < 250 and "others" not in first
    assert "999 others" in second and guard.rejected == 1001


@pytest.mark.parametrize(("host", "opened"), [("localhost", False), ("0.0.0.0", True)])
def test_address_is_one_that_others_can_open(host, opened):
    guard = gate.Gate(host, 0)
    guard._socket.close()
    place = urlsplit(guard.url)
    assert guard.is_open == opened and place.hostname != "0.0.0.0"
    request = Request(place.path, Headers(Host=place.netloc))
    assert not guard.fault_of_request(request)


def test_bytes_that_are_no_message_end_nothing(target):
    with target.client() as client:
        for noise in (b"", b"\xc1", b"\x91" * 10_000, bytes(range(256))):
            client.send(noise)
    with target.client() as client:
        client.send(bytes(2**20))
        with pytest.raises(websockets.ConnectionClosedError):
            for _ in client:
                pass
    with socket.create_connection(("127.0.0.1", target.gate.port)) as sock:
        sock.sendall(b"\x00nonsense\r\n\r\n")
        sock.recv(1000)
    target.goes_on()


def test_what_the_page_offers_is_granted(target):
    with target.client() as client:
        send(client, value_of(target.control("Hidden image"), "bars"))
        target.until(lambda: target.shown[-1].choice.image == "bars")
        send(client, value_of(target.control("Write scene and pictures"), True))
        target.until(lambda: target.saved)
        name, handle = next(iter(target.page.handles.items()))
        position = handle.center + np.array([0.01, 0, 0])
        named = {"name": f"/handles/{name}", "owner": ""}
        send(client, {"type": "TransformControlsDragStartMessage", **named})
        pose = {"wxyz": (1, 0, 0, 0), "position": position.tolist()}
        send(client, {"type": "TransformControlsUpdateMessage", **named, **pose})
        parameter = handle.names[0]
        target.until(lambda: abs(target.shown[-1].choice.values[parameter] - 0.01) < 1e-6)
    assert target.saved[0].choice.image == "bars"
    # The client left while it dragged.
    target.until(lambda: not target.shown[-1].is_coarse)
