"""The page's server as an attacker meets it: pages of others, and clients that send anything."""

import json
import re
import socket
import time
import urllib.error
import urllib.request
from base64 import b64encode
from contextlib import contextmanager
from hashlib import sha256
from urllib.parse import urlsplit

import numpy as np
import pytest

from periscopy_sim.scenario import load_scenario

websockets = pytest.importorskip("websockets")
from websockets.sync.client import connect  # noqa: E402

from periscopy_sim.live import gate  # noqa: E402

PHOTOGRAPH, HIDDEN = (24, 24), (6, 8)
PATIENCE = 240.0  # another process may be compiling, on a busy machine


class Target:
    """A session that runs, what it has saved and shown, and what an attacker knows of it."""

    def __init__(self, opened):
        scenario, self.saved = load_scenario("plate", HIDDEN, photograph=PHOTOGRAPH), []
        light = np.ones((*PHOTOGRAPH, 3))
        self.session = opened(scenario, "overcast", light, self.save)
        self.gate = self.session.gate
        self.origin = f"http://127.0.0.1:{self.gate.port}"

    def save(self, pictures):
        self.saved.append(pictures)
        return "saved"

    @property
    def latest(self):
        """The choice of the latest pictures shown; None before."""
        return self.session.shown[-1][1].choice if self.session.shown else None

    @contextmanager
    def client(self, token=None, origin=None, host=None):
        """Connect as a page would; without arguments as the page itself."""
        host = host or f"127.0.0.1:{self.gate.port}"
        token = self.gate.token if token is None else token
        with (
            socket.create_connection(("127.0.0.1", self.gate.port)) as sock,
            connect(
                f"ws://{host}/{token}/", sock=sock, origin=origin or self.origin, max_size=None
            ) as client,
        ):
            yield client

    def until(self, holds):
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end
            time.sleep(0.01)

    def goes_on(self):
        """Show that a new wish of the page itself is granted."""
        snr = 30.0 if self.session.choice.snr != 30 else 40.0
        with self.client() as client:
            send(client, value_of("snr", snr))
            self.until(lambda: self.latest.snr == snr)


def send(client, message):
    client.send(message if isinstance(message, str) else json.dumps(message))


def value_of(control, value):
    return {"control": control, "value": value}


@pytest.fixture(scope="module")
def target(opened):
    made = Target(opened)
    made.until(lambda: made.latest)
    return made


def test_a_viewer_sees_the_state_as_it_is(target):
    with target.client() as client:
        state = json.loads(client.recv(PATIENCE))
        assert {"room", "controls", "values", "handles", "panels", "photograph"} <= state.keys()
        assert state["values"]["method"] == target.session.choice.method
        target.session.show_trouble("it failed")
        assert json.loads(client.recv(PATIENCE))["trouble"] == ["it failed"]
    target.session.show_trouble("")


def test_a_slow_viewer_gets_the_latest_alone(target):
    with target.client() as client:
        client.recv(PATIENCE)
        for k in range(1000):
            target.session.show_trouble(str(k))
        got = []
        while not got or got[-1] != "999":
            got += json.loads(client.recv(PATIENCE)).get("trouble", [])
    target.session.show_trouble("")
    assert len(got) < 1000 and got == sorted(got, key=int)


def test_no_text_of_the_page_is_markup(target):
    """The script enters text as text, and no script but this one may run."""
    with urllib.request.urlopen(target.gate.url) as page:
        policy = page.headers["Content-Security-Policy"]
        (text,) = re.findall(r"<script>(.*?)</script>", page.read().decode(), re.DOTALL)
    digest = b64encode(sha256(text.encode()).digest()).decode()
    assert f"default-src 'none'; script-src 'sha256-{digest}';" in policy
    assert not re.search(r"(inner|outer)HTML|insertAdjacent|document\.write|eval|Function\(", text)


def test_pages_of_others_cannot_connect(target):
    for foreign in [
        {"origin": "http://evil.example"},
        {"origin": "http://127.0.0.1:1"},
        {"origin": "null"},
        {"host": "evil.example", "origin": "http://evil.example"},
        {"token": "guessed"},
        {"token": ""},
        {"token": "\u00fc"},
        {"host": "127.0.0.1.evil.example", "origin": "http://127.0.0.1.evil.example"},
    ]:
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
    for path in ("", "gate.py", "../page.js", "..%2fpage.py", "%2e%2e/__init__.py"):
        for url in (target.gate.url + path).rstrip("/"), target.gate.url + path:
            with urllib.request.urlopen(url) as page:
                assert page.read() == gate.PAGE  # and no file


def test_only_values_that_a_control_offers_are_accepted(target, tmp_path):
    own = tmp_path / "own.py"
    own.write_text(f"open({str(tmp_path / 'executed')!r}, 'w')\n")
    picture = tmp_path / "private.png"
    picture.write_bytes(b"")
    before, rejected = target.session.choice, target.gate.rejected
    drag = {"handle": "plate", "position": [0.0, 0.0, 0.0], "ends": False}
    nan = float("nan")
    attacks = [
        *(value_of("method", x) for x in (f"{own}:run", "file.py", "magic", "", None, [])),
        *(value_of("image", each) for each in (str(picture), "a" * 5000, "not known", {})),
        *(value_of("place", each) for each in ("window", str(tmp_path / "x.xml"), 1)),
        *(value_of("snr", each) for each in (-10_000, nan, 1e300, "60", True, None)),
        *(value_of("nobody", each) for each in (1, "noise-aware")),
        value_of(["snr"], 30),
        value_of("save", {"value": 1}),
        value_of("save", 1),
        value_of("method", "preconditioned") | {"options": []},
        {"control": "method"},
        drag | {"position": [nan, 0.0, 0.0]},
        drag | {"position": [float("inf"), 0.0, 0.0]},
        drag | {"position": [10**400, 0.0, 0.0]},
        drag | {"position": [0.0]},
        drag | {"position": "123"},
        drag | {"handle": "none"},
        drag | {"ends": 1},
        drag | {"more": 1},
        {},
        [1, 2],
        "1",
        "[" * 10_000,
        "no JSON",
        "1" * 10_000,
    ]
    with target.client() as client:
        for attack in attacks:
            send(client, attack)
        target.until(lambda: target.gate.rejected >= rejected + len(attacks))
    assert target.gate.rejected == rejected + len(attacks)
    assert target.session.choice == before
    assert not (tmp_path / "executed").exists() and not target.saved
    target.goes_on()


@pytest.mark.parametrize(("host", "opened"), [("localhost", False), ("0.0.0.0", True)])
def test_address_is_one_that_others_can_open(host, opened):
    guard = gate.Gate(host, 0, print)
    assert guard.is_open == opened and urlsplit(guard.url).hostname != "0.0.0.0"
    with urllib.request.urlopen(guard.url) as page:
        assert page.status == 200
    guard.close()
    guard.publish(trouble=["nobody sees this"])
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(guard.url)


def test_bytes_that_are_no_message_end_nothing(target):
    with target.client() as client:
        for noise in ("", b"", b"\x91" * 10_000, bytes(range(256)), "\x00"):
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
        send(client, value_of("image", "bars"))
        target.until(lambda: target.latest.image == "bars")
        send(client, value_of("save", True))
        target.until(lambda: target.saved)
        name, handle = next(iter(target.session.handles.items()))
        position = handle.center + np.array([0.01, 0, 0])
        send(client, {"handle": name, "position": position.tolist(), "ends": False})
        parameter = handle.names[0]
        target.until(lambda: abs(target.latest.values[parameter] - 0.01) < 1e-6)
        send(client, value_of("value occluder_dx", 0.02))
        target.until(lambda: target.latest.values["occluder_dx"] == 0.02)
        send(client, value_of("reset", True))
        target.until(lambda: target.latest.values["occluder_dx"] == 0)
        send(client, {"handle": name, "position": position.tolist(), "ends": False})
    assert target.saved[0].choice.image == "bars"
    # The client left while it dragged: full pictures follow.
    target.until(lambda: abs(target.latest.values[parameter] - 0.01) < 1e-6)
    target.until(lambda: not target.session.shown[-1][1].is_coarse)
