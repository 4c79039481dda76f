import numpy as np
import pytest
from periscopy_sim.storage.ambient_library import ambient_light, ambient_photographs, cached_light

import periscopy_sim as ps
from periscopy_sim.rendering.ambient import background
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage import ambient_library

OVERCAST = find_scene("ambient/overcast")


def scene(**parameters):
    return ps.load_scenario("chair", (4, 5), {"resolution": "12", **parameters})


@pytest.fixture
def rendered(monkeypatch):
    """Replace rendering by random numbers, for a list of the scenes that were rendered."""
    calls = []

    def render(path, scenario, *, target, seed, **_):
        calls.append(path.stem)
        rng = np.random.default_rng([seed, len(calls)])
        picture = rng.uniform(1, 2, (*scenario.photograph_shape, 3))
        return background.Background(picture, target, 0.0)

    monkeypatch.setattr(background, "render_background", render)
    return calls


def test_light_is_rendered_once_for_a_wall_whatever_stands_before_it(rendered, tmp_path):
    lit = scene()
    first = ambient_light(OVERCAST, lit, 0)
    assert (
        lit.view.edges.size and cached_light(OVERCAST, lit, 0).is_file()
    )  # the view keeps what it computes
    found = ambient_photographs(["overcast"], scene(occluder_dx="0.01"), tmp_path / "a", 0)
    ambient_photographs(["overcast"], scene(monitor_dx="0.01"), tmp_path / "b", 0)
    assert rendered == ["overcast"]
    assert (
        np.array_equal(found["overcast"].photograph, first.photograph)
        and first.relative_error == 3e-4
    )
    assert {file.name for file in tmp_path.rglob("*.exr")} == {"overcast.exr"}


def test_all_that_light_depends_on_makes_another(rendered, monkeypatch):
    lights = [
        (OVERCAST, scene(), 0, 3e-4), (OVERCAST, scene(resolution="14"), 0, 3e-4),
        (OVERCAST, scene(), 1, 3e-4), (OVERCAST, scene(), 0, 1e-3),
        (find_scene("ambient/snow"), scene(), 0, 3e-4),
    ]  # fmt: skip
    for path, scenario, seed, target in lights:
        ambient_light(path, scenario, seed, target=target)
    assert len(rendered) == len(lights)
    monkeypatch.setattr(ambient_library, "_renderer_sha256", lambda: "of other code")
    ambient_light(*lights[0][:3])
    assert len(rendered) == len(lights) + 1


def test_a_damaged_or_unwritable_cache_costs_time_alone(rendered, user_cache, monkeypatch):
    whole = ambient_light(OVERCAST, scene(), 0)
    (file,) = user_cache.rglob("*.exr")
    file.write_bytes(file.read_bytes()[:-100])
    again = ambient_light(OVERCAST, scene(), 0)
    assert len(rendered) == 2 and not np.array_equal(whole.photograph, again.photograph)
    assert np.array_equal(ambient_light(OVERCAST, scene(), 0).photograph, again.photograph)
    (user_cache / "taken").touch()
    monkeypatch.setenv("PERISCOPY_DATA", str(user_cache / "taken"))
    for count in (3, 4):
        ambient_light(OVERCAST, scene(), 0)
        assert len(rendered) == count


def test_the_cache_is_bounded_and_forgets_what_is_not_used(rendered, user_cache, monkeypatch):
    for seed in range(3):
        ambient_light(OVERCAST, scene(), seed)
    sizes = [file.stat().st_size for file in user_cache.rglob("*.exr")]
    monkeypatch.setattr(ambient_library, "CACHE_BYTES", 3.5 * max(sizes))
    ambient_light(OVERCAST, scene(), 0)
    ambient_light(OVERCAST, scene(), 3)  # in the place of 1
    held = [cached_light(OVERCAST, scene(), seed).is_file() for seed in range(4)]
    assert held == [True, False, True, True]
    assert len(rendered) == 4
