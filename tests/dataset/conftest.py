import pytest

from periscopy_sim.dataset.configuration import Configuration
from periscopy_sim.dataset.make import make_dataset

ENTRIES = {
    "seed": 3,
    "count": 46,
    "hidden": "3x4",
    "samples_per_geometry": 20,
    "samples_per_shard": 10,
    "clip_length": 2,
    "scenes": [
        {
            "scene": "plate",
            "parameters": {"occluder_dx": {"uniform": [-0.05, 0.05]}, "resolution": 16},
        }
    ],
    "hidden_images": [{"kind": "shapes"}, {"kind": "digits"}, {"kind": "moving"}],
    "ambient": [{"kind": "lamps", "weight": 2}, {"kind": "none"}],
    "light": {"kind": "direct", "samples": 16},
    "sbr": {"log_uniform": [0.1, 10]},
    "snr": {"uniform": [10, 20]},
    "exposure": {"uniform": [0.5, 2]},
    "keep_background": True,
}


@pytest.fixture(scope="session")
def configured():
    """Return a function that gives a small configuration, with changes."""

    def configuration(**changes):
        return Configuration.model_validate({**ENTRIES, **changes})

    return configuration


@pytest.fixture(scope="session")
def whole(configured, tmp_path_factory):
    """The data set of the small configuration."""
    path = tmp_path_factory.mktemp("whole") / "data.zarr"
    made = make_dataset(configured(), path)
    assert (made.count, made.made, made.geometries) == (46, 46, 3)
    return path
