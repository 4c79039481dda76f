"""Tags drawn into photographs by area, where a camera that is written out here sees them."""

from functools import cache

import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.wall_view import find_tags, project

cv2 = pytest.importorskip("cv2")

SIZE = (300, 450)
IDS, CENTERS = (3, 7, 11, 12), ((-0.25, 0.12), (0.25, 0.14), (-0.2, -0.15), (0.28, -0.13))
SIDES, ANGLES = (0.1, 0.09, 0.09, 0.11), (0.3, -0.8, 2.0, 0.0)
OFFSETS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])


def slanted_view():
    """A homography from metres to pixels: a pinhole camera 45 degrees off the wall's normal."""
    cos = np.sqrt(0.5)
    turn = np.array([[cos, 0, -cos], [0, -1, 0], [-cos, 0, -cos]])  # across, down, ahead
    inner = np.array([[650.0, 0, 225], [0, 650, 150], [0, 0, 1]])
    return inner @ np.column_stack([turn[:, 0], turn[:, 1], [0, 0, 1.4]])


VIEW = slanted_view()


def corners(k):
    cos, sin = np.cos(ANGLES[k]), np.sin(ANGLES[k])
    return project(VIEW, CENTERS[k] + SIDES[k] * OFFSETS @ np.array([[cos, sin], [-sin, cos]]))


@cache
def picture(family, ids=IDS, samples=6):
    """The wall with tags, each pixel the mean of samples x samples points."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{family}"))
    count = dictionary.markerSize + 2
    part = (np.arange(samples) + 0.5) / samples
    means = np.full(SIZE, 0.6)
    for number, center, side, angle in zip(ids, CENTERS, SIDES, ANGLES, strict=False):
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.array([[cos, sin], [-sin, cos]])
        paper = project(VIEW, center + 1.3 * side * OFFSETS @ turn)
        (left, top), (right, bottom) = paper.min(axis=0).astype(int), paper.max(axis=0).astype(int)
        row = (np.arange(top, bottom + 1)[:, None] + part).ravel()
        column = (np.arange(left, right + 1)[:, None] + part).ravel()
        places = np.stack(np.meshgrid(column, row), axis=-1).reshape(-1, 2)
        own = (project(np.linalg.inv(VIEW), places) - center) @ turn.T / side
        light = np.where((np.abs(own) < 0.65).all(axis=1), 0.9, 0.6)
        inside = (np.abs(own) < 0.5).all(axis=1)
        bits = cv2.aruco.generateImageMarker(dictionary, number, count) / 255
        cell = np.clip(((own[inside] * [1, -1] + 0.5) * count).astype(int), 0, count - 1)
        light[inside] = 0.05 + 0.85 * bits[cell[:, 1], cell[:, 0]]
        light = light.reshape(bottom + 1 - top, samples, right + 1 - left, samples)
        means[top : bottom + 1, left : right + 1] += light.mean(axis=(1, 3)) - 0.6
    return np.repeat(means[..., None], 3, axis=2)


@pytest.mark.parametrize("family", ["APRILTAG_36h11", "4X4_1000"])
def test_corners_of_either_kind_are_found_to_a_tenth_of_a_pixel(family):
    clean = picture(family)
    for noise in (0, 0.005):
        light = clean + np.random.default_rng(1).normal(0, noise, clean.shape)
        places, seen = find_tags(light, IDS)
        assert places.tolist() == [0, 1, 2, 3]
        for place, found in zip(places, seen, strict=True):
            # Which corner is the first is the family's affair: tags may be turned in any way.
            off = min(np.abs(np.roll(found, k, axis=0) - corners(place)).max() for k in range(4))
            assert off < 0.1


def test_a_tag_seen_twice_and_other_numbers_are_named():
    with pytest.raises(PhotographError, match="tag 3 twice"):
        find_tags(picture("4X4_1000", ids=(3, 3, 11, 12)), IDS)
    with pytest.raises(PhotographError, match=r"3, 7, 11, 12\] \(4X4_1000\)"):
        find_tags(picture("4X4_1000"), (500, 501))
    with pytest.raises(PhotographError, match="none of any family"):
        find_tags(np.full((*SIZE, 3), 0.5), IDS)
