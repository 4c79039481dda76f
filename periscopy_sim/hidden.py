"""The unknowns: hidden surfaces cut into patches, and the differences between neighbouring patches.

Arrays over all patches are row-major, surface after surface, with row 0 at a viewer's top.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError, plain_array, size_of
from periscopy_sim.scene import MONITOR, Scene

GAUSS = 0.5 / np.sqrt(3.0)
"""From the middle of an interval to either of Gauss and Legendre's two points, in its widths."""

Size: TypeAlias = tuple[int, int]
"""(rows, columns)."""

Sizes: TypeAlias = Size | str | Mapping[str, Size | str]
"""(R, C), or ROWSxCOLUMNS, of the only hidden surface, or of each by its id."""


def named(stem: str, by_id: Any) -> dict[str, Any]:
    """Return the values of surfaces by names: of the only one the stem, of several ``stem_ID``.

    They are a mapping by id, or the value of the only surface.
    """
    if not isinstance(by_id, Mapping):
        return {stem: by_id}
    return {f"{stem}_{name}" if len(by_id) > 1 else stem: each for name, each in by_id.items()}


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
    curved, whole
        Of a surface that is not flat: its 2 x 2 Gauss points in each patch, as (2 R, 2 C) patches
        of a quarter's edges; and its form, the surface in as many patches whatever R and C.
    """

    shape: Size
    centers: Array
    normals: Array
    across: Array
    up: Array
    mirrored: bool = False
    curved: "Surface | None" = None
    whole: "Surface | None" = None

    @classmethod
    def flat(cls, shape: Size) -> "Surface":
        """Return a plane of unit squares, for matrices that come without a scene."""
        rows, columns = shape
        y, x = np.divmod(np.arange(rows * columns), columns)
        centers = np.stack([x, -y, np.zeros_like(x)], axis=1).astype(np.float64)
        across, up, normals = (np.tile(axis, (len(centers), 1)) for axis in np.eye(3))
        return cls(shape, centers, normals, across, up)

    @cached_property
    def vertices(self) -> Array:
        """(R + 1, C + 1, 3) corners of the patches in metres; where patches meet, their mean."""
        rows, columns = self.shape
        total, count = np.zeros((rows + 1, columns + 1, 3)), np.zeros((rows + 1, columns + 1, 1))
        for down, right in product((0, 1), (0, 1)):
            ends = self.centers + (right - 0.5) * self.across + (0.5 - down) * self.up
            part = slice(down, down + rows), slice(right, right + columns)
            total[part] += ends.reshape(rows, columns, 3)
            count[part] += 1
        return np.asarray(total / count)

    def patches_at(self, uv: Array) -> NDArray[np.intp]:
        """Return the numbers of the patches, (n,), at places in the UV square, (n, 2)."""
        rows, columns = self.shape
        u, v = uv.T
        row = np.clip(((1 - v) * rows).astype(int), 0, rows - 1)
        column = np.clip(((1 - u if self.mirrored else u) * columns).astype(int), 0, columns - 1)
        return np.asarray(row * columns + column)

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
            curved=self.curved and self.curved.moved(motion),
            whole=self.whole and self.whole.moved(motion),
        )

    def placed(self, across: float, up: float, wider: float) -> "Surface":
        """Return the surface moved within itself, by so many patches across and up, and scaled.

        The ends of its longer side move outwards by `wider` patches.
        """
        (rows, columns), half = self.shape, max(self.shape) / 2
        y, x = np.divmod(np.arange(rows * columns)[:, None], columns)
        right = across + wider * (x + 0.5 - columns / 2) / half
        above = up - wider * (y + 0.5 - rows / 2) / half
        scale = 1 + wider / half
        return replace(
            self,
            centers=self.centers + right * self.across + above * self.up,
            across=scale * self.across,
            up=scale * self.up,
            curved=self.curved and self.curved.placed(2 * across, 2 * up, 2 * wider),
        )

    @property
    def gauss(self) -> "Surface":
        """The 2 x 2 Gauss points in each patch, as (2 R, 2 C) patches of a quarter's edges."""
        if self.curved is not None:
            return self.curved
        (rows, columns), places = self.shape, np.array([-GAUSS, GAUSS])

        def spread(values: Array) -> Array:
            """Return one value per patch, repeated at its points, (R, 2, C, 2, 3)."""
            grid = values.reshape(rows, 1, columns, 1, 3)
            return np.broadcast_to(grid, (rows, 2, columns, 2, 3))

        centers, normals, across, up = map(
            spread, (self.centers, self.normals, self.across, self.up)
        )
        offsets = places[:, None] * across - places[:, None, None, None] * up
        fine = (centers + offsets, normals, across / 2, up / 2)
        points, normals, across, up = (each.reshape(-1, 3) for each in fine)
        return Surface((2 * rows, 2 * columns), points, normals, across, up, self.mirrored)


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
    def of_scene(cls, scene: Scene, sizes: Sizes) -> "Hidden":
        """Return a scene's hidden surfaces in patches; a SceneError says why not."""
        if not isinstance(sizes, Mapping):
            sizes = dict.fromkeys(scene.emission, sizes)
        hidden: Hidden = scene.source.hidden(scene, sizes)
        return hidden

    @classmethod
    def of(cls, hidden: "Hidden | Sizes") -> "Hidden":
        """Return a hidden, or flat surfaces of sizes (R, C), whose patches are all alike."""
        if isinstance(hidden, Hidden):
            return hidden
        sizes: Any = hidden if isinstance(hidden, Mapping) else {MONITOR: hidden}
        return cls({name: Surface.flat(size_of(size)) for name, size in sizes.items()})

    def __getitem__(self, name: str) -> Surface:
        """Return a surface by its id."""
        return self._surfaces[name]

    def __iter__(self) -> Iterator[str]:
        """Return the ids in order."""
        return iter(self._surfaces)

    def __len__(self) -> int:
        """Return the number of surfaces."""
        return len(self._surfaces)

    @property
    def shapes(self) -> dict[str, Size]:
        """(R, C) of each surface by its id."""
        return {name: surface.shape for name, surface in self.items()}

    def __repr__(self) -> str:
        """Return the ids and sizes on one line."""
        return f"Hidden({self.sizes})"

    @property
    def sizes(self) -> str:
        """The sizes for messages: 29x36, or of several surfaces monitor=29x36, card=15x10."""
        each = {name: "{}x{}".format(*shape) for name, shape in self.shapes.items()}
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

    @property
    def shape(self) -> Size:
        """(R, C) of the only surface; a ValueError if there are several."""
        if len(self) > 1:
            raise InputError(f"there are hidden surfaces {', '.join(self)}; this takes one alone")
        return next(iter(self.values())).shape

    @property
    def is_flat(self) -> bool:
        """Whether this is one flat surface."""
        return len(self) == 1 and all(surface.curved is None for surface in self.values())

    def moved(self, motions: Mapping[str, Array]) -> "Hidden":
        """Return the surfaces moved by matrices, (4, 4), by their ids."""
        if not self.keys() & motions.keys():
            return self
        return Hidden({n: each.moved(motions.get(n, np.eye(4))) for n, each in self.items()})

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

    def unwrapped(self, by_id: Mapping[str, Any]) -> Any:
        """Return the value of the only surface, else those of all by their ids, in order."""
        values = {name: by_id[name] for name in self}
        return values if len(values) > 1 else next(iter(values.values()))

    def image(self, f: NDArray[Any]) -> Any:
        """Return (N, ...) as the image (R, C, ...) of the only surface, else as a mapping by id."""
        return self.unwrapped(self.split(f))

    def images(self, image: "Image | Mapping[str, Image]") -> dict[str, NDArray[Any]]:
        """Return the linear image of each surface by its id, of any size.

        An InputError says that one lacks, or is of unsigned integers, as pictures for screens are.
        """
        images = image if isinstance(image, Mapping) else {next(iter(self)): image}
        arrays = {n: plain_array(i, f"the image of '{n}'") for n, i in self.by_id(images).items()}
        for name, each in arrays.items():
            if each.dtype.kind == "u":
                raise InputError(
                    f"the image of '{name}' holds {each.dtype}: give linear light as float, or "
                    "scene.image(picture), which decodes the sRGB curve"
                )
        return arrays

    def by_id(self, images: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a mapping has for each surface, in order; an InputError if one lacks."""
        if images.keys() != self.keys():
            raise InputError(
                f"there are images of {', '.join(images)}, the hidden surfaces are "
                f"{', '.join(self)}; give an image of each by its id"
            )
        return {name: images[name] for name in self}

    def vector(self, image: "Image | Mapping[str, Image]") -> NDArray[Any]:
        """Return an image, (R, C, ...), or a mapping of such by id, as (N, ...): see `image`."""
        return self.join(self.images(image))

    @cached_property
    def differences(self) -> "Differences":
        """The gradient operator ∇ of images on these surfaces."""
        return Differences.joined([*self.differences_by_surface.values()])

    @cached_property
    def differences_by_surface(self) -> "dict[str, Differences]":
        """Each surface's own ∇ by its id: no difference crosses from one surface to another."""
        return {name: Differences.of_grid(shape) for name, shape in self.shapes.items()}


@dataclass(frozen=True, eq=False)
class Differences:
    """Forward differences down and across each surface, ∇: those past its border are zero.

    Attributes
    ----------
    following
        (2, N) number of the next patch down, and of the next across; the patch itself at a border.
    weights
        (2, N) weights of these differences: 1, and 0 at a border.
    borders
        (2, N) number of borders at which a patch lies down and across: 0 or 1, or 2 if it is alone.
    """

    following: NDArray[np.intp]
    weights: Array
    borders: NDArray[np.intp]

    @classmethod
    def of_grid(cls, shape: Size) -> "Differences":
        """Return ∇ on one surface, (R, C)."""
        numbers = np.arange(shape[0] * shape[1]).reshape(shape)
        following, weights, borders = np.stack([numbers] * 2), np.zeros((2, *shape)), []
        for axis, size in enumerate(shape):
            inside = (slice(None),) * axis + (slice(-1),)
            following[axis] = np.take(numbers, np.minimum(np.arange(size) + 1, size - 1), axis)
            weights[axis][inside] = 1
            ends = np.bincount([0, size - 1], minlength=size)
            borders.append(np.broadcast_to(np.expand_dims(ends, 1 - axis), shape).ravel())
        return cls(following.reshape(2, -1), weights.reshape(2, -1), np.stack(borders))

    @classmethod
    def joined(cls, parts: "Sequence[Differences]") -> "Differences":
        """Return ∇ on several surfaces, one after the other."""
        starts = np.cumsum([0, *(each.weights.shape[1] for each in parts[:-1])])
        following = [each.following + start for each, start in zip(parts, starts, strict=True)]
        weights, borders = (
            [getattr(each, name) for each in parts] for name in ("weights", "borders")
        )
        return cls(*(np.concatenate(each, axis=1) for each in (following, weights, borders)))

    def over_time(self, frames: int, weight: float) -> "Differences":
        """Return ∇ of the frames of a video, one after the other; the third difference is in time.

        Differences to the next frame have this weight, and there is none to darkness.
        """
        patches = self.weights.shape[1]
        still = self.joined([self] * frames)
        numbers = np.arange(frames * patches)
        has_next = numbers < (frames - 1) * patches
        return Differences(
            np.vstack([still.following, numbers + patches * has_next]),
            np.vstack([still.weights, weight * has_next]),
            np.vstack([still.borders, 0 * numbers]),
        )

    def __call__(self, f: NDArray[Any]) -> NDArray[Any]:
        """Return ∇f, (2, N, ...), of images f, (N, ...)."""
        weights = self.weights.astype(f.dtype, copy=False)
        return np.asarray(
            (f[self.following] - f) * np.expand_dims(weights, (*range(2, f.ndim + 1),))
        )

    def norms(self, f: NDArray[Any]) -> NDArray[Any]:
        """Return ‖∇f‖, (N,), over both directions and all channels of (N, C) or (N,) images."""
        steps = self(f)
        return np.asarray(np.sqrt(np.sum(steps.reshape(*steps.shape[:2], -1) ** 2, axis=(0, 2))))

    def variation_in_the_dark(self, f: NDArray[Any]) -> float:
        """Return Σ ‖∇f‖ of images, (N, C), where all beyond the borders is dark, too."""
        bright = np.linalg.norm(f, axis=1)
        after = (self.weights == 0) & (self.borders > 0)
        before = (self.borders - after).sum(axis=0)  # at differences of patches beyond
        inside = np.hypot(self.norms(f), np.sqrt(after.sum(axis=0)) * bright)
        return float(np.sum(inside + before * bright))

    @cached_property
    def matrix(self) -> Any:
        """∇ as a sparse matrix, (2 N, N): differences down first."""
        from scipy import sparse

        weights = sparse.diags_array(self.weights.ravel())
        own = sparse.vstack([sparse.eye_array(self.weights.shape[1])] * len(self.weights))
        return (weights @ (sparse.vstack(self._shifts) - own)).tocsr()

    @cached_property
    def in_the_dark(self) -> Any:
        """∇ of images that are dark beyond the borders, a row for each difference, sparse."""
        from scipy import sparse

        inside = self.matrix[self.weights.ravel() > 0]
        dark = sparse.eye_array(self.borders.shape[1], format="csr")
        beyond = [np.repeat(np.arange(len(each)), each) for each in self.borders]
        return sparse.vstack([inside, dark[np.concatenate(beyond)]], format="csr")

    @cached_property
    def norm_bound(self) -> float:
        """An upper bound of ‖∇‖², 8 in a plane: differences along a line have 4."""
        return 4 * float(np.sum(self.weights.max(axis=1) ** 2))

    def slopes(self, f: NDArray[Any]) -> NDArray[Any]:
        """Return derivatives by patches, (2, N, ...), of images, (N, ...), dark beyond the borders.

        They are central differences over five patches, (8 (f₊ − f₋) − (f₊₊ − f₋₋))/12, exact for
        polynomials of degree 4.
        """
        flat = f.reshape(len(f), -1)
        moved = []
        for ahead in self._shifts:
            near = ahead @ flat - ahead.T @ flat
            far = ahead @ (ahead @ flat) - ahead.T @ (ahead.T @ flat)
            moved.append((8 * near - far) / 12)
        return np.reshape(moved, (len(moved), *f.shape))

    @property
    def _shifts(self) -> list[Any]:
        """For each axis the sparse matrix, (N, N), that puts the next patch in each one's place."""
        from scipy import sparse

        N = self.weights.shape[1]
        rows = np.arange(N)
        ahead = (self.weights > 0).astype(np.float64)
        places = zip(ahead, self.following, strict=True)
        return [sparse.csr_array((each, (rows, next_)), (N, N)) for each, next_ in places]
