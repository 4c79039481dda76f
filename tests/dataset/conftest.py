import pytest

from periscopy_sim.dataset.configuration import Configuration

ENTRIES = {
    "seed": 3,
    "count": 46,
    "hidden": "3x4",
    "samples_per_geometry": 20,
    "samples_per_shard": 10,
    "clip_length": 2,
    "scenes": [
        {
            "scene": "chair",
            "parameters": {"occluder_dx": {"uniform": [-0.05, 0.05]}, "resolution": 16},
        }
    ],
    "hidden_images": [{"kind": "shapes"}, {"kind": "digits"}, {"kind": "moving"}],
    "ambient": [{"kind": "lamps", "weight": 2}, {"kind": "none"}],
    "light": {"kind": "direct"},
    "sbr": {"log_uniform": [0.1, 10]},
    "snr": {"uniform": [20, 60]},
    "exposure": {"uniform": [0.5, 2]},
    "keep_background": True,
}


@pytest.fixture(scope="session")
def configured():
    """Return a function that gives a small configuration, with changes."""

    def configuration(**changes):
        return Configuration.model_validate({**ENTRIES, **changes})

    return configuration
