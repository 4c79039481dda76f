"""The unknowns: hidden surfaces cut into patches, and the differences between neighbouring patches.

Arrays over all patches are row-major, surface after surface, with row 0 at a viewer's top.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.scene import Scene

Size: TypeAlias = tuple[int, int]
"""(rows, columns)."""

FLAT = "monitor"
"""Id of the only surface of a `Hidden` that is made of a size alone."""

EVEN = 1e-4
"""Relative difference of distances between patches, up to which they count as equal: rounding of
single precision in a scene's coordinates leaves less."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A hidden surface in R x C patches, as a viewer who faces it sees them.

    Attributes
    ----------
    shape
        (R, C).
    centers
        (R C, 3) centres in metres.
    normals
        (R C, 3) unit normals of the emitting side.
    across, up
        (R C, 3) edge vectors in metres along a viewer's right and up; their cross product's norm is
        the patch's area.
    mirrored
        Whether the shape's u coordinate runs to a viewer's left, so that the columns run against
        it.
    """

    shape: Size
    centers: Array
    normals: Array
    across: Array
    up: Array
    mirrored: bool = False

    @classmethod
    def flat(cls, shape: Size) -> "Surface":
        """Return a plane of unit squares, for matrices that come without a scene."""
        rows, columns = shape
        y, x = np.divmod(np.arange(rows * columns), columns)
        centers = np.stack([x, -y, np.zeros_like(x)], axis=1).astype(np.float64)
        across, up, normals = (np.tile(axis, (len(centers), 1)) for axis in np.eye(3))
        return cls(shape, centers, normals, across, up)

    def moved(self, motion: Array) -> "Surface":
        """Return the surface moved by a matrix, (4, 4)."""
        linear = motion[:3, :3]
        normals = self.normals @ np.linalg.inv(linear)
        return replace(
            self,
            centers=self.centers @ linear.T + motion[:3, 3],
            normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
            across=self.across @ linear.T,
            up=self.up @ linear.T,
        )


class Hidden(Mapping[str, Surface]):
    """The N patches of hidden surfaces by their ids, in the order of A's columns.

    Parameters
    ----------
    surfaces
        The surfaces by id, one at least.

    Attributes
    ----------
    patches
        N.
    slices
        The columns of A that each surface has, by its id.
    """

    def __init__(self, surfaces: Mapping[str, Surface]) -> None:
        if not surfaces:
            raise InputError("there is no hidden surface; give one at least")
        self._surfaces = dict(surfaces)
        ends = np.cumsum([0, *(np.prod(each.shape, dtype=int) for each in surfaces.values())])
        self.slices = {
            name: slice(int(start), int(stop))
            for name, start, stop in zip(surfaces, ends[:-1], ends[1:], strict=True)
        }
        self.patches = int(ends[-1])

    @classmethod
    def of_scene(cls, scene: Scene, size: Size) -> "Hidden":
        """Return a scene's hidden surfaces in (R, C) patches; a SceneError says why not."""
        hidden: Hidden = scene.source.hidden(scene, size)
        return hidden

    @classmethod
    def of(cls, hidden: "Hidden | Size | Mapping[str, Size]") -> "Hidden":
        """Return a hidden, or flat surfaces of sizes (R, C), whose patches are all alike."""
        if isinstance(hidden, Hidden):
            return hidden
        sizes: Any = hidden if isinstance(hidden, Mapping) else {FLAT: hidden}
        return cls({name: Surface.flat((int(R), int(C))) for name, (R, C) in sizes.items()})

    def __getitem__(self, name: str) -> Surface:
        """Return a surface by its id."""
        return self._surfaces[name]

    def __iter__(self) -> Iterator[str]:
        """Return the ids in order."""
        return iter(self._surfaces)

    def __len__(self) -> int:
        """Return the number of surfaces."""
        return len(self._surfaces)

    def __repr__(self) -> str:
        """Return the ids and sizes on one line."""
        return f"Hidden({self.sizes})"

    @property
    def sizes(self) -> str:
        """The sizes for messages: 29x36, or of several surfaces monitor=29x36, card=15x10."""
        each = {name: "{}x{}".format(*surface.shape) for name, surface in self.items()}
        return ", ".join(
            size if len(self) == 1 else f"{name}={size}" for name, size in each.items()
        )

    @cached_property
    def centers(self) -> Array:
        """(N, 3) centres of all patches in metres."""
        return np.concatenate([surface.centers for surface in self.values()])

    @cached_property
    def normals(self) -> Array:
        """(N, 3) unit normals of all patches."""
        return np.concatenate([surface.normals for surface in self.values()])

    @cached_property
    def across(self) -> Array:
        """(N, 3) edges of all patches along a viewer's right, in metres."""
        return np.concatenate([surface.across for surface in self.values()])

    @cached_property
    def up(self) -> Array:
        """(N, 3) edges of all patches along a viewer's up, in metres."""
        return np.concatenate([surface.up for surface in self.values()])

    def moved(self, motions: Mapping[str, Array]) -> "Hidden":
        """Return the surfaces moved by matrices, (4, 4), by their ids."""
        if not self.keys() & motions.keys():
            return self
        return Hidden({n: each.moved(motions.get(n, np.eye(4))) for n, each in self.items()})

    def shifted(self, across: float = 0.0, up: float = 0.0) -> "Hidden":
        """Return the surfaces moved within themselves, by so many patches across and up."""
        return Hidden({
            name: replace(each, centers=each.centers + across * each.across + up * each.up)
            for name, each in self.items()
        })  # fmt: skip

    def split(self, f: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return each surface's image, (R, C, ...), of a vector over all patches, (N, ...)."""
        return {
            name: f[part].reshape(*self[name].shape, *f.shape[1:])
            for name, part in self.slices.items()
        }

    def join(self, images: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """Return the vector over all patches, (N, ...), of each surface's image, (R, C, ...).

        An InputError says that an image is missing, or is not of its surface's size.
        """
        for name, surface in self.items():
            if name not in images or images[name].shape[:2] != surface.shape:
                given = images[name].shape if name in images else "none"
                raise InputError(f"the image of '{name}' has {surface.shape} patches, not {given}")
        flat = (images[name].reshape(-1, *images[name].shape[2:]) for name in self)
        return np.concatenate(list(flat))

    def image(self, f: NDArray[Any]) -> Any:
        """Return (N, ...) as the image (R, C, ...) of the only surface, else as a mapping by id."""
        images = self.split(f)
        return images if len(images) > 1 else next(iter(images.values()))

    def vector(self, image: "Image | Mapping[str, Image]") -> NDArray[Any]:
        """Return an image, (R, C, ...), or a mapping of such by id, as (N, ...): see `image`."""
        images = image if isinstance(image, Mapping) else {next(iter(self)): np.asarray(image)}
        return self.join(images)

    @cached_property
    def differences(self) -> "Differences":
        """The gradient operator ∇ of images on these surfaces."""
        following, weights, borders = [], [], []
        for part, surface in zip(self.slices.values(), self.values(), strict=True):
            numbers = np.arange(part.start, part.stop).reshape(surface.shape)
            places = surface.centers.reshape(*surface.shape, 3)
            for axis, size in enumerate(surface.shape):
                steps = np.linalg.norm(np.diff(places, axis=axis), axis=-1)
                last = [(0, int(k == axis)) for k in (0, 1)]
                weights.append(np.pad(_even(steps.mean() / steps) if size > 1 else steps, last))
                following.append(np.where(weights[-1] > 0, np.roll(numbers, -1, axis), numbers))
                place = np.arange(size)
                dark = np.sqrt((place == 0) * 1.0 + (place == size - 1))
                borders.append(np.broadcast_to(np.expand_dims(dark, 1 - axis), surface.shape))
        return Differences(*map(_by_axis, (following, weights, borders)))


@dataclass(frozen=True, eq=False)
class Differences:
    """Forward differences down and across each surface, ∇: those past its border are zero.

    On a grid of equal patches they have weight 1. Where patches lie at different distances, as on a
    curved surface, a difference is weighted by the surface's mean distance along that axis over its
    own: a derivative.

    Attributes
    ----------
    following
        (2, N) number of the next patch down, and of the next across; the patch itself at a border.
    weights
        (2, N) weights of these differences; 0 at a border.
    borders
        (2, N) weights of the differences to darkness beyond the borders: 1 at a border, else 0; √2
        where one patch lies at both.
    """

    following: NDArray[np.intp]
    weights: Array
    borders: Array

    def __call__(self, f: NDArray[Any]) -> NDArray[Any]:
        """Return ∇f, (2, N, ...), of images f, (N, ...)."""
        weights = self.weights.astype(f.dtype, copy=False)
        return np.asarray(
            (f[self.following] - f) * np.expand_dims(weights, (*range(2, f.ndim + 1),))
        )

    def norms(self, f: NDArray[Any]) -> NDArray[Any]:
        """Return ‖∇f‖, (N,), over both directions and all channels of (N, C) or (N,) images."""
        steps = self(f)
        return np.asarray(np.sqrt(np.sum(steps.reshape(2, len(f), -1) ** 2, axis=(0, 2))))

    @cached_property
    def matrix(self) -> Any:
        """∇ as a sparse matrix, (2 N, N): differences down first."""
        from scipy import sparse

        N = self.weights.shape[1]
        rows, weights = np.arange(2 * N), self.weights.ravel()
        ahead = sparse.csr_array((weights, (rows, self.following.ravel())), (2 * N, N))
        own = sparse.csr_array((weights, (rows, np.tile(np.arange(N), 2))), (2 * N, N))
        return (ahead - own).tocsr()

    @cached_property
    def in_the_dark(self) -> Any:
        """∇ of images that are dark beyond the borders, sparse (2 N + borders, N)."""
        from scipy import sparse

        borders = sparse.vstack([sparse.diags_array(each) for each in self.borders], format="csr")
        return sparse.vstack([self.matrix, borders[self.borders.ravel() > 0]], format="csr")


def _by_axis(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Return values of patches, (2, N), from those of each surface down and across, in turn."""
    return np.stack([np.concatenate([each.ravel() for each in parts[axis::2]]) for axis in (0, 1)])


def _even(weights: Array) -> Array:
    """Return weights, exactly 1 where all are equal but for rounding."""
    return np.ones_like(weights) if np.allclose(weights, 1, rtol=0, atol=EVEN) else weights
