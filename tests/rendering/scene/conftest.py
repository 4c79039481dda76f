import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.transport.shadow_rays import render_transport

BY_BSDF = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}

SEEDS = 8


@pytest.fixture(scope="session")
def refusal():
    """Return the message, of one line that names the file, by which a scene is refused."""

    def refuse(path, *arguments, **options):
        with pytest.raises(SceneError) as caught:
            SceneNodes(path, *arguments, **options).instantiate()
        message = str(caught.value)
        assert "\n" not in message
        assert f"'{path}'" in message
        return message

    return refuse


@pytest.fixture
def is_right(room, same_mean, mitsubas):
    """Assert that A of a white monitor is the file's photograph, sampled as `truth` says."""

    def check(*extra, samples=16, across=4, truth=BY_BSDF, **parts):
        parts = {"monitor": room.monitor(room.area)} | parts
        seen = room.load(*extra, **parts)
        seen = seen.averaged(across)
        found = [render_transport(seen, samples=samples, seed=s).sum(axis=1) for s in range(SEEDS)]
        gain = seen.channel_gain.mean()
        pictures = mitsubas(room.write(*extra, **parts), seeds=SEEDS, **truth)
        same_mean([picture.ravel() / gain for picture in pictures], found)

    return check
