import socket

import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.movable import Movable
from periscopy_sim.live.page import grouped, refuse_taken


def test_what_begins_alike_is_grouped_and_the_rest_comes_last():
    names = ["seat_width", "lamp_x", "monitor_x", "lamp_turn", "falloff"]
    movables = {name: Movable(name, 0, -1, 1, 0.1) for name in names}
    assert grouped(movables, ["lamp_x", "monitor_x"]) == [
        ("lamp", ["lamp_x", "lamp_turn"], True),
        ("monitor", ["monitor_x"], True),
        ("other parameters", ["seat_width", "falloff"], False),
    ]
    assert grouped(movables, [])[0][2]  # nothing else would be seen


def test_a_port_that_is_taken_is_refused():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(PeriscopyError, match=f"cannot listen on 127.0.0.1:{port}: .*--port"):
            refuse_taken("127.0.0.1", port)
    refuse_taken("127.0.0.1", port)


def test_an_address_of_another_computer_is_refused():
    with pytest.raises(PeriscopyError, match=r"cannot listen on 192\.0\.2\.1:8080: .* --host"):
        refuse_taken("192.0.2.1", 8080)
