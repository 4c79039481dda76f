import numpy as np
import pytest

from periscopy_sim.analytic import area_transport
from periscopy_sim.calibration.silhouette import recover_silhouette
from periscopy_sim.errors import PhotographError, SceneError
from tests.scenes.silhouette import FLAG, HIDDEN, photograph


@pytest.mark.thorough
def test_known_pictures_show_nearly_every_cell_whatever_the_colours_of_a_camera(
    scene, photographs, images
):
    mixture = np.array([[0.7, 0.2, 0.1], [0.1, 0.6, 0.2], [0.0, 0.1, 1.3]])
    given, progress = (scene, HIDDEN, "card", FLAG.shape), []
    others = [each @ mixture for each in photographs]
    solution, mixed = (
        recover_silhouette(each, *given, shown=images, progress=progress.append)
        for each in (photographs, others)
    )
    assert np.mean(solution.opaque == FLAG) > 0.95
    assert solution.unexplained < 0.25 * solution.unexplained_open
    assert not solution.doubts and progress[-1] == 1
    assert np.mean(solution.opaque == mixed.opaque) > 0.95


@pytest.mark.thorough
def test_a_flag_before_an_unknown_image_is_found(scene, photographs):
    solution = recover_silhouette(photographs[0], scene, HIDDEN, "card", FLAG.shape)
    assert np.mean(solution.opaque == FLAG) > 0.95
    assert solution.unexplained < 0.5 * solution.unexplained_open
    assert not solution.doubts


def test_a_photograph_without_a_shadow_of_it_raises(scene, empty, images, monkeypatch):
    monkeypatch.setattr(area_transport, "PIXEL_POINTS", 40)
    light = [photograph(empty, image, 1) for image in images]
    with pytest.raises(PhotographError, match="no shadow of 'card'"):
        recover_silhouette(light, scene, HIDDEN, "card", (4, 4), shown=images)


def test_photographs_beyond_the_pictures_raise(scene, photographs, images):
    with pytest.raises(PhotographError, match="2 photographs of 1"):
        recover_silhouette(photographs, scene, HIDDEN, "card", (4, 4), shown=images[:1])


def test_a_mask_out_of_sight_raises(scene, photographs):
    with pytest.raises(SceneError, match="casts no shadow"):
        recover_silhouette(photographs[0], scene, HIDDEN, "card", (4, 4), parameters={"shift": 2})
