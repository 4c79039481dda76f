import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.options import LightOptions
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.memo import Memo
from periscopy_sim.rendering import bounced
from periscopy_sim.rendering import transport as planning
from periscopy_sim.storage.transport_matrix import read_transport

pytestmark = pytest.mark.usefixtures("jit")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")


@pytest.mark.usefixtures("every_wall_point")
def test_transport_has_its_closed_form_unless_rays_are_asked_for(scenario):
    for light, method, by, samples in [
        (LightOptions(), "noise-aware", "areas", None),
        (LightOptions(), "mine.py:Mine", "areas", None),
        (LightOptions(), "preconditioned", "rays", 16),
        (LightOptions(model="analytic"), "preconditioned", "areas", None),
        (LightOptions(samples=4), "noise-aware", "rays", 4),
        (LightOptions(model="rendered"), "noise-aware", "rays", 128),
    ]:
        plan = replace(scenario, light=light.of(scenario)).plan(0.005, method)
        assert (plan.by, plan.samples) == (by, samples)


def test_noise_of_exactly_none_is_not_unknown_noise(scenario, monkeypatch):
    asked = []
    monkeypatch.setattr(planning, "planned", lambda _, noise, **__: (asked.append(noise), None))
    fresh = replace(scenario, memo=Memo())
    for noise in (0.0, None):
        fresh.plan(noise)
    assert asked == [0.0, planning.NOISE]


def test_what_the_matrix_lacks_is_named_once(succeeds, tmp_path):
    lamp = '<emitter type="point" id="lamp"><point name="position" x="1" y="0.5" z="1"/></emitter>'
    text = ps.find_scene("plate").read_text()
    (tmp_path / "lit.xml").write_text(text.replace("</scene>", f"{lamp}</scene>"))
    succeeds("photograph", "lit.xml", "bars", *TINY[:4], "--samples", "64", "--out", "y.exr")
    size = TINY[:4]
    succeeds("reconstruct", "y.exr", "--scene", "lit.xml", *size, "--samples", "1", "--out", "r")
    warnings = json.loads((tmp_path / "r" / "summary.json").read_text())["warnings"]
    assert sum("'lamp'" in line for line in warnings) == 1
    assert sum("rays" in line for line in warnings) == 1


def test_matrix_of_another_pose_is_refused(refused, succeeds, tmp_path):
    succeeds("transport", "chair", *TINY, "-D", "occluder_dx=0.01", "--out", "A.npy")
    np.save(tmp_path / "y.npy", np.ones((24, 24)))
    given = ("reconstruct", "y.npy", "--scene", "chair", *TINY[:4], "--transport", "A.npy")
    assert "--samples" in refused(*given, "--samples", "4", "--out", "r")
    line = refused(*given, "--out", "r")
    assert line.startswith("A.npy: ") and "parameters.occluder_dx" in line and "0.01" in line
    (tmp_path / "A.json").write_text("{")
    assert refused(*given, "--out", "r").startswith("A.json: ")


@pytest.fixture
def rough(monkeypatch):
    """Trace few paths: the rest of the light is as good for what is tested here."""
    trace = partial(bounced.render_bounced_light, target=0.1)
    monkeypatch.setattr(bounced, "render_bounced_light", trace)


@pytest.mark.usefixtures("rough")
def test_matrix_with_bounces_is_written_and_read(succeeds, tmp_path):
    said = succeeds("transport", "bright_room", *TINY, "--bounces", "2", "--out", "A.npy")
    assert all(name in said for name in ("A.npy", "A.json", "A.bounced.npz"))
    scenario = ps.load_scenario("bright_room", (4, 5), {"resolution": "24"})
    direct = ps.render_transport(scenario, samples=4)
    expected = bounced.add_bounces(scenario, direct, 2)
    A = read_transport(tmp_path / "A.npy", scenario, 2)
    assert np.asarray(A).tobytes() == np.asarray(expected).tobytes()
    f = np.random.default_rng(1).random((20, 3))
    # BLAS rounds by where in memory a matrix begins.
    np.testing.assert_allclose(A @ f, expected @ f, rtol=1e-14)
    record = json.loads((tmp_path / "A.json").read_text())
    assert record["bounces"] == "2"
    assert record["bounced_relative_error"] == expected.bounced.relative_error


def test_bounces_are_direct_all_or_a_number():
    assert [LightOptions(bounces=text).most_bounces for text in ("direct", "all", "3")] == [
        1,
        None,
        3,
    ]
    for text in ("0", "-1", "2.5", "none", "", "1e3", "9" * 5000):
        with pytest.raises(PeriscopyError, match="--bounces"):
            LightOptions(bounces=text)


@pytest.fixture
def column(scenario, tmp_path):
    """The light, (576,), of a lamp so near to the wall that Eq. 4's grid cannot imitate it."""
    lamp = np.array([[0.15, 0.1, 0.2]])  # across, away, up
    column = ps.point_light_backgrounds(scenario, lamp)[:, 0]
    np.save(tmp_path / "B.npy", column[:, None])
    return column


@pytest.mark.usefixtures("few_lights")
def test_columns_of_several_sources_are_joined(column, scenario, tmp_path):
    light = LightOptions(light_model=[str(tmp_path / "B.npy"), "grid"])
    B = replace(scenario, light=light.of(scenario)).B
    np.testing.assert_array_equal(B[:, 0], column)
    np.testing.assert_array_equal(B[:, 1:], ps.point_light_backgrounds(scenario))
    assert LightOptions().sources == ["grid"]


def test_source_that_cannot_be_taken_is_refused(scenario):
    for source in ["B.npy", "chair"]:
        with pytest.raises(PeriscopyError, match=source):
            LightOptions(light_model=[source]).of(scenario)


def test_method_without_a_light_model_is_refused():
    LightOptions().check_methods("pseudoinverse")
    with pytest.raises(PeriscopyError, match="pseudoinverse"):
        LightOptions(light_model=["grid"]).check_methods("noise-aware", "pseudoinverse")
