import numpy as np
import pytest
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.silhouette.masked_scene import write_masked_scene
from periscopy_sim.calibration.silhouette.replaced_shape import with_mesh
from periscopy_sim.calibration.silhouette.search.mask_level import NOTHING, MaskLevel
from periscopy_sim.calibration.silhouette.search.mask_moves import patch_steps
from periscopy_sim.calibration.silhouette.search.mask_walk import walk
from periscopy_sim.calibration.silhouette.search.opacity_descent import ONWARD, descend
from scipy.ndimage import shift

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.silhouette.recover import FINE
from periscopy_sim.calibration.silhouette.result import overlap
from periscopy_sim.measurement import add_noise
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from tests.calibration.silhouette.conftest import silhouette

STEPS = np.array([[-1.5, 0.0], [0.0, 1.6]])
MASK = np.zeros((12, 12))
MASK[4:8, 5:8] = 1


class Dips:
    """An evidence with a dip wherever a mask is so many steps aside; how deep each is, is known."""

    smoothness = np.eye(2)

    def __init__(self, floors):
        self.goals = np.array([shift(MASK, np.array(at) @ STEPS, order=1) for at in floors])
        self.floors = np.array(list(floors.values()))

    def best_ratio(self, *_):
        return 1.0

    def at(self, opacities, _, __, start):
        off = opacities - self.goals.reshape(len(self.goals), -1)
        values = self.floors + 2000 * np.sum(off**2, axis=1)
        nearest = int(np.argmin(values))
        return values[nearest], 4000 * off[nearest], start

    def descended(self, at):
        return descend(self, shift(MASK, np.array(at) @ STEPS, order=1), ONWARD)


def test_a_walk_goes_from_dip_to_dip_to_the_deepest():
    dips = Dips({(0, 0): -900.0, (0, 1): -600.0, (1, 2): -300.0, (-1, 0): -700.0})
    found = dips.descended((1, 2))
    assert np.abs(found.opacities - dips.goals[2]).max() < 0.3  # a descent stays where it is
    end = walk(dips, found, STEPS)
    assert end.objective < found.objective - 250
    np.testing.assert_allclose(end.opacities, MASK, atol=0.02)


def test_a_walk_stays_where_no_step_gains():
    dips = Dips({(0, 0): -900.0, (0, 1): -600.0, (-1, -1): -700.0})
    found = dips.descended((0, 0))
    assert walk(dips, found, STEPS) is found


class Worsening(Dips):
    """One by which what a look found is worse for a descent that follows."""

    def at(self, opacities, α, allowance, start):
        value, slope, start = super().at(opacities, α, allowance, start)
        return value + α, slope, start

    def __init__(self, floors):
        super().__init__(floors)
        self.descents = 0

    def best_ratio(self, *_):
        self.descents += 1
        return 0.0 if self.descents <= 9 else 1000.0


def test_what_a_look_promised_and_a_descent_does_not_keep_is_not_taken():
    dips = Worsening({(0, 0): -900.0, (0, 1): -600.0})
    found = dips.descended((0, 1))
    assert walk(dips, found, STEPS) is found


def test_what_is_no_number_is_not_walked_to():
    dips = Dips({(0, 0): -900.0, (0, 1): -600.0})
    found = dips.descended((0, 1))
    dips.floors = dips.floors * np.nan
    assert walk(dips, found, STEPS) is found


def test_every_place_that_is_looked_at_is_told():
    dips = Dips({(0, 0): -900.0, (0, 1): -600.0})
    count = []
    walk(dips, dips.descended((0, 1)), STEPS, lambda: count.append(1))
    assert len(count) == 2 * 8  # about the first and about where that led


HOOK = np.array([[cell == "#" for cell in row] for row in (
    "........",
    "........",
    "..####..",
    "..####..",
    "..#.....",
    "..#.....",
    "........",
    "........",
)])  # fmt: skip


@pytest.mark.thorough
@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("aside", [(1, 0), (-1, 1)])
def test_a_mask_a_patch_aside_walks_back(scene, plane, aside):
    """A patch is one and a half cells; the image's border is black."""
    hidden = 10, 12
    hooked, mesh = scene.with_name("hooked.xml"), scene.with_name("hooked.ply")
    write_masked_scene(scene, silhouette(plane, HOOK), {}, hooked, mesh, mesh.name)
    image = np.zeros((*hidden, 3))
    image[2:-2, 2:-2] = 0.1 + np.random.default_rng(7).random((6, 8, 3)) ** 2
    A = render_transport(load_scenario(hooked, hidden), samples=36, pixel_samples=9, seed=11)
    photograph = add_noise((A @ image.reshape(-1, 3)).reshape(40, 40, 3), 60, 3)
    empty = scene.with_name("empty.xml")
    empty.write_text(with_mesh(scene, "card", None, {}, scene.parent), encoding="utf-8")
    level = MaskLevel.of(
        ResolutionLevel(
            empty, {}, (), Prior.none(0), photograph, [], None, hidden, FINE, 0, lambda _: None
        ),
        plane,
        HOOK.shape,
    )
    steps = patch_steps(plane, level.level.scenario(NOTHING), level.cells)
    start = np.clip(shift(HOOK.astype(float), np.array(aside) @ steps, order=1), 0, 1)
    there = descend(level.evidence, start, ONWARD)
    assert overlap(there.opaque, HOOK, 0) < 0.7  # a descent alone does not find back
    end = walk(level.evidence, there, steps)
    assert overlap(end.opaque, HOOK, 0) == 1
