"""What a calibration is about: photographs of a scene, its free parameters, and their prior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from periscopy_sim.analytic.area_transport import points_across
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.evidence import (
    HALF_WAVES,
    CorrelatedNoise,
    SharpImages,
    SmoothImages,
)
from periscopy_sim.calibration.moving_scene import LARGEST, MovingScene, limit_size, limit_sizes
from periscopy_sim.calibration.prior import UncertainParameters, row_priors
from periscopy_sim.calibration.resolution_level import Group, ResolutionLevel, averages
from periscopy_sim.errors import PhotographError
from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.model.fit import camera_noise
from periscopy_sim.model.transport_operator import background_basis, joined_basis
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.photograph import Photograph
from periscopy_sim.storage.pictures import area_average, averaged_photograph
from periscopy_sim.view import Geometry, View

MOST_PATCHES = 36
"""Patches along a side of each hidden image: of more, a coarser image serves."""

COARSE_PIXELS, COARSE_PATCHES, COARSE_HATS = 500, 24, 16
"""Pixels of the coarse level, about, patches along the longer side of its images, and hats there.
By 1,000, 36 and 24 a search takes three times as long there, and finds the valleys no better."""

POINTS = 63
"""Along the longer side of the wall, at least, where derivatives are computed."""

PIXELS_A_PATCH = 3.8
"""Least pixels per patch of the fine level."""

JOINT_PIXELS_A_PATCH, JOINT_HATS = 1.7, 24
"""Least pixels per patch of the level that gives the errors, and hats along its images."""


def shown_light(picture: Image | Mapping[str, Image], hidden: Hidden) -> Array:
    """Return the light of the N patches, (N, P), that show a picture, (R, C, P) of any R and C.

    Of several hidden surfaces it is a mapping of such by id.
    """
    images = hidden.images(picture)
    return hidden.join({n: area_average(each, hidden[n].shape) for n, each in images.items()})


def evenly_coloured(light: Array, view: View, pixels: Mask) -> Array:
    """Return light in M pixels of a view, (M, C), without the colours of the wall's texture."""
    if view.texture is None:
        return light
    gain = view.channel_gain[pixels.ravel()]
    gain = gain if gain.shape[1] == light.shape[1] else gain.mean(axis=1, keepdims=True)
    return np.asarray(light * gain.mean(axis=0) / gain)


def ambient_basis(view: View, pixels: Mask, photograph: Photograph) -> Array:
    """Return an orthonormal basis, (M, r), of the ambient light in M pixels of a view.

    The photographs with the monitor off, which belong to a photograph, show some of it.
    """
    Q = background_basis(point_light_backgrounds(view)[pixels.ravel()])
    off = [evenly_coloured(e[pixels], view, pixels) for e in photograph.monitor_off.values()]
    return joined_basis(Q, np.hstack([Q[:, :0], *off]))


@dataclass(frozen=True, eq=False)
class CalibrationProblem:
    """Photographs of a scene, P parameters to find, and U fixed at uncertain values."""

    scenario: Geometry  # at the measured values
    names: tuple[str, ...]  # of the P parameters to find
    centers: Array  # (P,) their measured values
    errors: Array  # (P,) standard deviations of these
    uncertain: UncertainParameters  # the U that are fixed
    photographs: Sequence[Photograph]  # of one laboratory and one mask
    pictures: Sequence[Image | Mapping[str, Image]]  # of the first ones, see `shown_light`
    logarithmic: tuple[str, ...] = ()  # names whose centers and errors are those of the logarithm
    half_waves: int = HALF_WAVES  # of smooth misfit to which unknown images bend

    @cached_property
    def hidden(self) -> Hidden:
        """The hidden surfaces, in patches as the search has them."""
        return self._in_patches(MOST_PATCHES)

    @property
    def has_unknown_images(self) -> bool:
        """Whether the monitor showed an unknown image in one of the photographs."""
        return len(self.pictures) < len(self.photographs)

    def camera_noise(self, pixels: int) -> Array:
        """Return the standard deviation of white noise, (K, C), in averages of so many pixels.

        It is 0 if unknown.
        """
        planes = np.concatenate([each.planes for each in self._averaged])
        noise = camera_noise(planes)
        noise = np.zeros(len(planes)) if noise is None else noise
        fewer = np.sqrt(pixels / self._averaged[0].pixels.size)
        return np.asarray(fewer * noise.reshape(len(self._averaged), -1))

    def coarse(self) -> ResolutionLevel:
        """Return the level on which a search begins."""
        hidden = self._in_patches(COARSE_PATCHES)
        images = SmoothImages.hats(hidden, self._in_patches(COARSE_HATS))
        return self._level(hidden, 0.0, images, points=1)

    def fine(self) -> ResolutionLevel:
        """Return the level of fine descents."""
        sharp = SharpImages(self.hidden, self.photographs[0].channels)
        level = self._level(self.hidden, PIXELS_A_PATCH, sharp)
        finest = self._averaged[0]
        across, part = points_across(finest.shape), level.scene.scenario
        scene = self._scene(finest.pixels, across, part.hidden)
        by = averages(finest.pixels, part.view.shape, across, scene.scenario.paint)
        return replace(level, finer=(scene, by))

    def medium(self) -> ResolutionLevel:
        """Return a level of images of few edges in large patches."""
        hidden = self._in_patches(COARSE_PATCHES)
        images = SharpImages(hidden, self.photographs[0].channels)
        return self._level(hidden, JOINT_PIXELS_A_PATCH, images)

    def joint(self) -> ResolutionLevel:
        """Return the level on which errors are estimated, also of the uncertain parameters.

        Unknown images may stand anywhere on their surfaces, of any size: the last numbers place
        these, three each. Else the images' prior, which is dark beyond the border, would pretend to
        measure their place.
        """
        images = SmoothImages.hats(self.hidden, self._in_patches(JOINT_HATS))
        level = self._level(self.hidden, JOINT_PIXELS_A_PATCH, images)
        names = (*self.names, *self.uncertain.names)
        shapes = [] if self.pictures else level.scene.scenario.hidden.shapes.values()
        place = [n for rows, columns in shapes for n in (columns, rows, max(rows, columns) / 4)]
        centers = np.concatenate([self.centers, self.uncertain.values, np.zeros(len(place))])
        errors = np.concatenate([self.errors, self.uncertain.standard_errors, place])
        scene = replace(level.scene, names=names, errors=errors)
        return replace(level, scene=scene, centers=centers)

    def _in_patches(self, longest: int) -> Hidden:
        """Return the hidden surfaces in at most so many patches along a side."""
        return Hidden.of_scene(self.scenario.scene, limit_sizes(self.scenario.hidden, longest))

    @cached_property
    def _averaged(self) -> list[Photograph]:
        own = self.photographs[0].shape
        # Hardly larger photographs keep all pixels: averages over 1.1 of them would share noise.
        shape = limit_size(own, max(own) // max(1, round(max(own) / LARGEST)))
        return [averaged_photograph(photograph, shape) for photograph in self.photographs]

    def _level(
        self,
        hidden: Hidden,
        a_patch: float,
        unknown: SmoothImages | SharpImages,
        points: int = POINTS,
    ) -> ResolutionLevel:
        """Return the level of averaged photographs, of about so many pixels a patch.

        `COARSE_PIXELS` is the least, if there are as many.
        """
        finest = self._averaged[0]
        count = max(COARSE_PIXELS, a_patch * hidden.patches)
        by = max(1, round(np.sqrt(finest.pixels.sum() / count)))
        shape = limit_size(finest.shape, max(finest.shape) // by)
        averaged = [averaged_photograph(photograph, shape) for photograph in self._averaged]
        first = averaged[0]
        pixels = first.pixels
        scene = self._scene(pixels, -(-points // max(shape)), hidden)
        view = self._view(shape)
        Q = ambient_basis(view, pixels, first)
        if len(Q) <= 2 * Q.shape[1]:
            raise PhotographError(
                f"{len(Q)} pixels are used, too few beside {Q.shape[1]} kinds of ambient light; "
                "give a larger photograph, or mask less of it"
            )
        light = [evenly_coloured(each.values[pixels], view, pixels) for each in averaged]
        groups = []
        for y, picture in zip(light, self.pictures, strict=False):
            shown = shown_light(picture, hidden)
            rows = row_priors(y.shape[1], shown.shape[1])
            each = zip(y.T[:, None, :, None], rows, strict=True)
            groups += [Group(channel, SmoothImages.shown(shown, row)) for channel, row in each]
        if self.has_unknown_images:
            groups.append(Group(np.array(light[len(self.pictures) :]), unknown))
        # Only unknown images bend to smooth misfit: with a known one a real chair is 0.3 dB worse.
        waves = self.half_waves if self.has_unknown_images else 0
        noise = CorrelatedNoise.white(pixels, Q, waves)
        return ResolutionLevel(scene, self.centers, Q, tuple(groups), noise, photographs=len(light))

    def _view(self, shape: Size, across: int = 1) -> View:
        """Return the view of photographs averaged to a shape."""
        own = self.scenario.view
        return View.of(own.scene, shape, across=across, camera=own.camera)

    def _scene(self, pixels: Mask, across: int, hidden: Hidden) -> MovingScene:
        view = self._view(pixels.shape, across).of_pixels(pixels)
        return MovingScene(Geometry(view, hidden), self.names, self.errors, self.logarithmic)
