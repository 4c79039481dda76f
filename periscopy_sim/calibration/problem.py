"""What a calibration is about: photographs of a scene, its free parameters, and their prior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.colours import row_priors
from periscopy_sim.calibration.evidence import SmoothImages
from periscopy_sim.calibration.moving_scene import (
    LARGEST,
    MovingScene,
    limit_size,
    limit_sizes,
)
from periscopy_sim.calibration.prior import UncertainParameters
from periscopy_sim.calibration.resolution_level import Group, ResolutionLevel
from periscopy_sim.calibration.sharp_images import SharpImages
from periscopy_sim.errors import PhotographError
from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.model.ambient import background_basis, joined_basis
from periscopy_sim.model.noise import camera_noise
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.photograph import Photograph
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.pictures import area_average, averaged_photograph
from periscopy_sim.view import View

MOST_PATCHES = 36
"""Along a side of each hidden image: of more, a coarser image serves."""

COARSE_PIXELS, COARSE_HATS = 1000, 24
"""Pixels of the coarse level, about, and hat functions along the longer side of its images."""

PIXELS_A_PATCH, JOINT_PIXELS_A_PATCH = 3.8, 1.7
"""Of the fine level, and of the one for errors, at least."""


def finest_view(view: View, shape: Size) -> View:
    """Return the view of averaged photographs, over `LARGEST` wall points along a side at least."""
    return View.of(view.scene, shape, across=-(-LARGEST // max(shape)), camera=view.camera)


def shown_light(picture: Image | Mapping[str, Image], hidden: Hidden) -> Array:
    """Return the light of the N patches, (N, P), that show a picture, (R, C, P) of any R and C.

    Of several hidden surfaces it is a mapping of such by id.
    """
    images = hidden.images(picture)
    return hidden.join({n: area_average(each, hidden[n].shape) for n, each in images.items()})


def ambient_basis(view: View, pixels: Mask, photograph: Photograph) -> Array:
    """Return an orthonormal basis, (M, r), of the ambient light in M pixels of a view.

    The photographs with the monitor off, which belong to a photograph, show some of it.
    """
    Q = background_basis(point_light_backgrounds(view)[pixels.ravel()])
    off = [each[pixels] for each in photograph.monitor_off.values()]
    return joined_basis(Q, np.hstack([Q[:, :0], *off]))


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """Photographs of a scene, P parameters to find, and U that are held at uncertain values."""

    scenario: Scenario  # at the measured values
    names: tuple[str, ...]  # of the P parameters to find
    centers: Array  # (P,) their measured values
    errors: Array  # (P,) standard deviations of these
    uncertain: UncertainParameters  # the U that are held
    photographs: Sequence[Photograph]  # of one laboratory and one mask
    pictures: Sequence[Image | Mapping[str, Image]]  # of the first ones, see `shown_light`

    @property
    def has_unknown_images(self) -> bool:
        """Whether the monitor showed an unknown image in one of the photographs."""
        return len(self.pictures) < len(self.photographs)

    @property
    def camera_noise(self) -> Array:
        """(K, C) standard deviation of white noise in the averaged photographs, 0 if unknown."""
        planes = np.concatenate([each.planes for each in self._averaged])
        noise = camera_noise(planes)
        noise = np.zeros(len(planes)) if noise is None else noise
        return noise.reshape(len(self._averaged), -1)

    def coarse(self) -> ResolutionLevel:
        """Return the level on which a search begins."""
        return self._level(0.0, self._smooth)

    def fine(self) -> ResolutionLevel:
        """Return the level of fine descents."""
        images = SharpImages(self._in_patches(MOST_PATCHES), self.photographs[0].channels)
        return self._level(PIXELS_A_PATCH, images)

    def joint(self) -> ResolutionLevel:
        """Return the level on which errors are estimated, also of the uncertain parameters.

        Unknown images may stand anywhere on their surfaces: the last numbers move these, two each.
        Else the images' prior, which is dark beyond the border, would pretend to measure their
        place.
        """
        level = self._level(JOINT_PIXELS_A_PATCH, self._smooth)
        names = (*self.names, *self.uncertain.names)
        shapes = [] if self.pictures else level.scene.scenario.hidden.shapes.values()
        place = [size for shape in shapes for size in reversed(shape)]
        centers = np.concatenate([self.centers, self.uncertain.values, np.zeros(len(place))])
        errors = np.concatenate([self.errors, self.uncertain.standard_errors, place])
        scene = replace(level.scene, names=names, errors=errors)
        return replace(level, scene=scene, centers=centers)

    @property
    def _smooth(self) -> SmoothImages:
        return SmoothImages.hats(*map(self._in_patches, (MOST_PATCHES, COARSE_HATS)))

    def _in_patches(self, longest: int) -> Hidden:
        """Return the hidden surfaces in at most so many patches along a side."""
        return Hidden.of_scene(self.scenario.scene, limit_sizes(self.scenario.hidden, longest))

    @cached_property
    def _averaged(self) -> list[Photograph]:
        shape = limit_size(self.photographs[0].shape, LARGEST)
        return [averaged_photograph(photograph, shape) for photograph in self.photographs]

    def _level(self, a_patch: float, unknown: SmoothImages | SharpImages) -> ResolutionLevel:
        """Return the level of pixels on a lattice, about so many a patch if there are as many.

        `COARSE_PIXELS` is the least.
        """
        hidden = self._in_patches(MOST_PATCHES)
        first, count = self._averaged[0], max(COARSE_PIXELS, a_patch * hidden.patches)
        stride = max(1, round(np.sqrt(first.pixels.sum() / count)))
        pixels = np.zeros_like(first.pixels)
        pixels[stride // 2 :: stride, stride // 2 :: stride] = True
        pixels &= first.pixels
        view = finest_view(self.scenario.view, first.shape)
        part = Scenario(view.of_pixels(pixels), hidden)
        scene = MovingScene(part, self.names, self.errors)
        Q = ambient_basis(view, pixels, first)
        if len(Q) <= 2 * Q.shape[1]:
            raise PhotographError(
                f"{len(Q)} pixels are used, too few beside {Q.shape[1]} kinds of ambient light; "
                "give a larger photograph, or mask less of it"
            )
        light = [each.values[pixels] for each in self._averaged]
        groups = []
        for y, picture in zip(light, self.pictures, strict=False):
            shown = shown_light(picture, hidden)
            rows = row_priors(y.shape[1], shown.shape[1])
            each = zip(y.T[:, None, :, None], rows, strict=True)
            groups += [Group(channel, SmoothImages.shown(shown, row)) for channel, row in each]
        if self.has_unknown_images:
            groups.append(Group(np.array(light[len(self.pictures) :]), unknown))
        return ResolutionLevel(scene, self.centers, Q, tuple(groups), len(light))
