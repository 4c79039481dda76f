"""Wall, monitor and camera: the ids that a scene must have."""

import numpy as np
import pytest


@pytest.mark.parametrize(
    ("missing", "kind", "others"),
    [
        ("wall", "shape", "its shapes: 'monitor', 'ball'"),
        ("monitor", "shape", "its shapes: 'wall', 'ball'"),
        ("camera", "sensor", "its sensors: none"),
    ],
)
def test_missing_part_of_the_contract_is_refused_with_what_there_is(
    room, missing, kind, others, refusal
):
    message = refusal(room.write(room.blocker(), **{missing: ""}))
    assert message.endswith(f"has no {kind} with id '{missing}' ({others})")


def test_an_alias_serves_as_the_wall(room):
    wall = room.wall().replace('id="wall"', 'id="board"') + '<alias id="board" as="wall"/>'
    aliased, plain = room.load(wall=wall), room.load()
    np.testing.assert_array_equal(aliased.wall_points, plain.wall_points)
    assert aliased.occluders == ()
    camera = room.camera().replace('id="camera"', 'id="eye"') + '<alias id="eye" as="camera"/>'
    np.testing.assert_array_equal(room.load(camera=camera).wall_points, plain.wall_points)


def test_one_shape_by_two_names_is_refused(room, refusal):
    path = room.write('<alias id="wall" as="monitor"/>', monitor="")
    assert "two of the ids wall, monitor, camera name one node" in refusal(path)


@pytest.mark.parametrize("part", ["wall", "monitor"])
@pytest.mark.parametrize("holder", ["shapegroup", "merge"])
def test_shape_within_another_is_refused_by_name(room, part, holder, refusal):
    inner = getattr(room, part)()
    group = f'<shape type="{holder}" id="group">{inner}</shape>'
    shown = '<shape type="instance" id="shown"><ref id="group"/></shape>'
    path = room.write(**{part: group + (shown if holder == "shapegroup" else "")})
    assert f"shape '{part}' lies within another shape; put it into" in refusal(path)
