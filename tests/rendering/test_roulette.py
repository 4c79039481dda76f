import numpy as np
import pytest

from periscopy_sim.rendering.roulette import ROULETTE, SURVIVAL, survivors

pytestmark = pytest.mark.usefixtures("jit")

COUNT = 1 << 16


def after(surface, strength):
    """Throughput, 0 of paths that ended, of many whose strongest channel has that strength."""
    import drjit as dr
    import mitsuba as mi

    numbers = (dr.arange(mi.Float, COUNT) + 0.5) / COUNT
    throughput = mi.Color3f(strength / 2, strength, 0) + dr.zeros(mi.Float, COUNT)
    kept, active = survivors(mi.UInt32(surface), throughput, numbers, mi.Bool(True))
    alive = np.array(active & dr.full(mi.Bool, True, COUNT))
    return np.array(kept.y) * alive, np.array(kept.x) * alive, alive


@pytest.mark.parametrize("strength", [0.01, 0.3, 0.9, 1.0, 3.0])
@pytest.mark.parametrize("surface", [1, ROULETTE - 1, ROULETTE, 20])
def test_light_in_the_mean_is_what_it_was(surface, strength):
    strong, weak, alive = after(surface, strength)
    assert strong.mean() == pytest.approx(strength, rel=2e-3)
    np.testing.assert_allclose(weak, strong / 2, rtol=1e-5)
    chance = min(strength, SURVIVAL) if surface >= ROULETTE else 1
    assert np.mean(alive) == pytest.approx(chance, abs=1e-3)


@pytest.mark.parametrize("surface", [1, 20])
def test_paths_without_light_end(surface):
    *_, alive = after(surface, 0.0)
    assert not alive.any()
