import numpy as np
import pytest

from periscopy_sim.rendering.photograph import render_photograph
from periscopy_sim.rendering.transport.bounced import BouncedTransport, render_bounced_light
from periscopy_sim.rendering.transport.shadow_rays import render_transport


@pytest.fixture
def agrees(same_mean):
    """Assert that A f is the path-traced photograph of a random f; return A f, (seeds, M, 3)."""

    def check(seen, bounces=1, *, seeds=12, samples=256, target=2e-3):
        image = np.random.default_rng(0).random((*seen.hidden_shape, 3))
        predicted, traced = [], []
        for seed in range(seeds):
            A = render_transport(seen.averaged(4), samples=16, seed=seed)
            if bounces != 1:
                light = render_bounced_light(seen, bounces=bounces, target=target, seed=seed)
                A = BouncedTransport(A + light.rows(slice(None)), light, bounces)
            predicted.append((A @ image.reshape(-1, 3)) * seen.channel_gain)
            options = {"samples": samples, "bounces": bounces, "seed": 1000 + seed}
            traced.append(render_photograph(seen, image, **options))
        same_mean(traced, predicted)
        return np.array(predicted)

    return check
