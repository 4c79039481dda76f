"""A camera with a thin lens: what it blurs, A blurs."""

import numpy as np
import pytest

from periscopy_sim.analytic.area_transport import analytic_transport
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.transport.shadow_rays import render_transport

SEEDS = 8


@pytest.mark.thorough
@pytest.mark.parametrize("pixel_samples", [1, 4])
def test_blur_of_a_lens_is_in_the_matrix(room, same_mean, mitsubas, pixel_samples):
    """Pixels of 4 mm, so that their centres stand for them, blurred by 70 mm at a shadow's edge."""
    camera = room.lens(0.05, 0.5, (12, 12), angle=2.5)
    options = {"camera": camera, "monitor": room.monitor(room.area, scale=(0.02, 0.02))}
    ball = room.blocker("0.48, 0.5, 0.3", 0.03)
    seen = room.load(ball, **options)
    # The spot at a right angle; the wall is slanted by 27 degrees.
    spot, cosine = 0.05 * (np.sqrt(1.25) - 0.5) / 0.5, 1 / np.sqrt(1.25)
    assert spot / cosine < seen.blur < spot / cosine**2
    found = [
        render_transport(seen, seed=s, pixel_samples=pixel_samples).sum(axis=1)
        for s in range(SEEDS)
    ]
    one_bounce = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    truth = [x.ravel() for x in mitsubas(room.write(ball, **options), **one_bounce)]
    assert np.mean(truth, axis=0).min() > 0.2 * np.max(truth)
    pinhole = room.load(ball, **options | {"camera": camera.replace("0.05", "1e-6")})
    assert render_transport(pinhole).sum(axis=1).min() == 0
    same_mean(truth, found)


def test_closed_form_takes_a_lens_in_focus_alone(room):
    sharp = room.load(camera=room.lens(0.01, 1.12))
    assert analytic_transport(sharp).any()
    with pytest.raises(SceneError, match=r"shape 'wall' is blurred by 0\.1\d* m; focus the camera"):
        analytic_transport(room.load(camera=room.lens(0.05, 0.4)))
