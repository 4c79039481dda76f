from periscopy_sim.live.movable import Movable
from periscopy_sim.live.page import grouped


def test_what_begins_alike_is_grouped_and_the_rest_comes_last():
    names = ["seat_width", "lamp_x", "monitor_x", "lamp_turn", "falloff"]
    movables = {name: Movable(name, 0, -1, 1, 0.1) for name in names}
    assert grouped(movables, ["lamp_x", "monitor_x"]) == [
        ("lamp", ["lamp_x", "lamp_turn"], True),
        ("monitor", ["monitor_x"], True),
        ("other parameters", ["seat_width", "falloff"], False),
    ]
    assert grouped(movables, [])[0][2]  # nothing else would be seen
