"""The matrix A against path-traced photographs."""

import pytest

from tests.scenes.materials import GLOSSY, painted


@pytest.mark.parametrize(
    "name",
    [
        "plate",
        pytest.param("chair", marks=pytest.mark.thorough),
        pytest.param("plant", marks=pytest.mark.thorough),
    ],
)
def test_matrix_times_image_is_the_path_traced_photograph(shipped, agrees, name):
    agrees(shipped(name))


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["glossy", "colored", "tilted", "flipped", "mirrored", "sphere"])
def test_matrix_times_image_is_the_photograph_in_any_room(room, agrees, kind):
    parts = {
        "glossy": {"wall": room.wall(GLOSSY)},
        "colored": {"wall": room.wall(painted("0.9, 0.3, 0.15"))},
        "tilted": {"monitor": room.monitor(scale=(0.1, 0.3), turn=170, tilt=10)},
        "flipped": {"monitor": room.monitor(flip=True, turn=0)},
        "mirrored": {"monitor": room.monitor(scale=(-0.2, 0.15))},
        "sphere": {},
    }[kind]
    extra = [room.blocker()] if kind == "sphere" else []
    agrees(room.load(*extra, hidden=(2, 3), **parts))


@pytest.mark.parametrize(
    ("emitter", "mirrored"),
    [pytest.param("area", False, marks=pytest.mark.thorough), ("lcd", True)],
)
def test_matrix_times_image_is_the_photograph_with_a_curved_monitor(
    room, agrees, emitter, mirrored
):
    light = room.area if emitter == "area" else room.lcd(6, 2)
    monitor = room.curved_monitor(light, mirrored=mirrored)
    seen = room.load(room.blocker(), monitor=monitor, hidden=(2, 5))
    assert seen.hidden["monitor"].mirrored == mirrored
    agrees(seen)
