"""What a camera sees of the wall, and the hidden patches: the rows and the columns of A."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.numerics import Array
from periscopy_sim.scene import Scene, SceneDocument
from periscopy_sim.view import View

FARTHEST = 1e3
"""Distance from the origin over the longer side of what the camera sees of the wall: there single
precision makes an error of 1e-3 in A, as much as the noise of a 60 dB photograph."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """A view of the wall and the hidden surfaces of one scene: all that direct light depends on.

    M is the number of pixels of the view, N the number of patches of the hidden image; both are
    row-major with row 0 at the top.

    Attributes
    ----------
    view
        What the camera sees of the wall.
    hidden
        The hidden surfaces in patches.

    Raises
    ------
    SceneError
        If the scene has no such hidden surface, single precision does not resolve the places, or
        of a hidden surface no patch faces what the camera sees of the wall.
    """

    view: View
    hidden: Hidden

    def __post_init__(self) -> None:
        for name in self.hidden:
            if name not in self.scene.emission:
                known = ", ".join(self.scene.emission)
                raise SceneError(f"scene '{self.path}' has hidden surfaces {known}, no '{name}'")
        points, normals = self.view.centers, self.view.center_normals
        rows, columns = self.view.shape
        ends = self.view.corners[1]
        corners = [ends[k] for k, size in ((1, columns), (3, rows)) if size > 1]
        sides = [float(np.linalg.norm(end - ends[0])) for end in corners]
        far = np.abs(np.concatenate([points, self.hidden.centers])).max()
        if sides and (far > FARTHEST * max(sides) or 0 in sides):
            raise SceneError(
                f"scene '{self.path}': wall or monitor are {far:.3g} from the origin, and the "
                f"camera sees {max(sides):.3g} of the wall: too far for float32. Move the scene to "
                "the origin, or widen the camera's view"
            )
        # Of a plane wall, a corner of the photograph sees what any of its pixels sees.
        points = np.concatenate([points, ends])
        normals = np.concatenate([normals, np.tile(normals.mean(axis=0), (len(ends), 1))])
        for name, surface in self.hidden.items():
            for center, normal in zip(surface.centers, surface.normals, strict=True):
                way = center - points
                if ((way @ normal < 0) & (np.sum(normals * way, axis=1) > 0)).any():
                    break
            else:
                raise SceneError(
                    f"scene '{self.path}': hidden surface '{name}' faces away from the wall that "
                    "the camera sees, or is behind it; turn it round, flip its normals "
                    "(flip_normals), or move it"
                )

    def at(self, **values: str | float) -> Self:
        """Return the same with other values for its file's ``<default>``s: `Scene.at`.

        Where things merely move, and no shape comes near the camera's view, this takes a few
        milliseconds.
        """
        scene = self.scene.at(**values)
        hidden = Hidden.of_scene(scene, self.hidden.shapes)
        return replace(self, view=self._seen(scene, self.view.across), hidden=hidden)

    def averaged(self, across: int) -> Self:
        """Return the same with each pixel averaged over so many points along each side."""
        if across == self.view.across:
            return self
        return replace(self, view=self._seen(self.scene, across))

    def _seen(self, scene: Scene, across: int) -> View:
        """Return the view of a scene in the same pixels."""
        own = self.view
        shape = own.shape if own.is_cut else None
        view = View.of(scene, shape, across=across, camera=own.camera)
        return view if own.pixels is None else view.of_pixels(own.pixels)

    def __repr__(self) -> str:
        """Return its file, sizes and parameters on one line."""
        given = "".join(f", {name}={value}" for name, value in self.parameters.items())
        rows, columns = self.photograph_shape
        sizes = f"{self.hidden.sizes} patches, {rows}x{columns} pixels"
        return (
            f"{type(self).__name__}('{self.path}', {sizes}, "
            f"{len(self.view.occluders)} occluders{given})"
        )

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.view.scene

    @property
    def document(self) -> SceneDocument:
        """The Mitsuba scene file and what it declares."""
        return self.scene.document

    @property
    def path(self) -> Path:
        """The Mitsuba scene file."""
        return self.scene.path

    @property
    def parameters(self) -> Mapping[str, str]:
        """Values given for the file's ``<default>``s."""
        return self.scene.parameters

    @property
    def photograph_shape(self) -> Size:
        """(rows, columns) of the photograph."""
        return self.view.shape

    @property
    def hidden_shape(self) -> Size:
        """(R, C) of the hidden image, of one surface."""
        return self.hidden.shape

    @property
    def channel_gain(self) -> Array:
        """(3,) or (M, 3) the wall's colour, see `View`."""
        return self.view.channel_gain

    @property
    def paint(self) -> Array:
        """(M, 1) or (1, 1) the brightness of the wall in A and B, see `View`."""
        return self.view.paint

    @property
    def transport_shape(self) -> tuple[int, int]:
        """(M, N), the shape of the light transport matrix."""
        return len(self.view.points), self.hidden.patches
