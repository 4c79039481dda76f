"""What the commands make of --light-model: what ambient light may be made of."""

import json

import numpy as np
import pytest

import periscopy_sim as ps

pytestmark = pytest.mark.usefixtures("jit", "few_lights")

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
LAMP = """<scene version="3.0.0">
    <sensor type="orthographic" id="camera">
        <transform name="to_world">
            <scale x="0.2" y="0.2"/>
            <lookat origin="0, -1, 0" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
        <film type="hdrfilm"><integer name="width" value="24"/>
            <integer name="height" value="24"/></film>
    </sensor>
    <shape type="rectangle" id="wall">
        <transform name="to_world"><rotate x="1" angle="90"/></transform>
        <bsdf type="diffuse"/>
    </shape>
    <emitter type="point"><point name="position" x="0.15" y="-0.1" z="0.2"/></emitter>
</scene>
"""


@pytest.fixture
def lamp(tmp_path):
    """A scene of a lamp so near to the wall that Eq. 4's grid cannot imitate it."""
    (tmp_path / "lamp.xml").write_text(LAMP)
    return tmp_path / "lamp.xml"


@pytest.fixture
def column(lamp, scenario):
    """What it sends to the wall, (576,)."""
    return ps.emitter_backgrounds(lamp, scenario)[:, 0]


@pytest.fixture
def lit(photographs, column, tmp_path):
    """Write a photograph beside the lamp."""
    photograph = photographs[0] + 3 * photographs.mean() * column.reshape(24, 24, 1)
    np.save(tmp_path / "y.npy", photograph)
    return photograph


@pytest.fixture
def reconstruct(succeeds, tmp_path):
    def run(*options):
        succeeds("reconstruct", "y.npy", "--scene", "chair", *TINY, *options, "--out", "out")
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        return np.load(tmp_path / "out" / "reconstruction.npy"), summary

    return run


@pytest.mark.parametrize("source", ["lamp.xml", "B.npy"])
def test_light_that_is_among_them_is_taken_for_ambient(
    reconstruct, lit, column, clip, scenario, transport, tmp_path, source
):
    np.save(tmp_path / "B.npy", column[:, None])
    image, summary = reconstruct("--method", "preconditioned", "--light-model", source)
    assert summary["ambient_prototypes"] == [source]
    method = ps.Periscope.for_scene(scenario, transport, column[:, None])
    np.testing.assert_allclose(image, method.reconstruct(lit), rtol=1e-3, atol=1e-4)
    by_grid, summary = reconstruct("--method", "preconditioned")
    assert summary["ambient_prototypes"] == ["grid"]
    assert ps.psnr(image, clip[0]) > ps.psnr(by_grid, clip[0]) + 3


@pytest.mark.usefixtures("lamp")
def test_prototypes_of_several_sources_are_joined(succeeds, tmp_path):
    ranks = {}
    for sources in (("grid",), ("lamp.xml",), ("grid", "lamp.xml")):
        options = [word for source in sources for word in ("--light-model", source)]
        succeeds("analyze", "chair", *TINY, *options, "--out", "found")
        summary = json.loads((tmp_path / "found" / "summary.json").read_text())
        assert summary["ambient_prototypes"] == list(sources)
        ranks[sources] = summary["background_rank"]
    assert ranks["lamp.xml",] == 1
    assert ranks["grid", "lamp.xml"] == ranks["grid",] + 1


@pytest.mark.usefixtures("lit")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--light-model", "B.npy"), "B.npy: no such file"),
        (("--light-model", "nowhere.xml"), "nowhere.xml"),
        (("--light-model", "grid", "--light-model", "grid"), "--light-model grid is given twice"),
        (("--light-model", "y.npy"), "y.npy: holds an array of shape (24, 24, 3)"),
        (("--light-model", "chair"), "its monitor is none of the lamps of a room"),
        (
            ("--method", "pseudoinverse", "--light-model", "lamp.xml"),
            "the method pseudoinverse takes no prototypes of ambient light",
        ),
    ],
)
def test_what_cannot_be_taken_is_refused(refused, options, message):
    line = refused("reconstruct", "y.npy", "--scene", "chair", *TINY, *options, "--out", "out")
    assert message in line
