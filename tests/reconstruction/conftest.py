"""Images that the tests of total variation denoise, and what minimizes without the package."""

from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.reconstruction.total_variation import solve_total_variation


@pytest.fixture(scope="session")
def random_image():
    """White noise of any shape."""

    def draw(*shape, seed=0):
        return np.random.default_rng(seed).normal(size=shape)

    return draw


@pytest.fixture(scope="session")
def solved():
    """`solve_total_variation` of ([frames, ]R, C[, channels]) images; frames where w is given."""

    def solve(g, weight, w=None, p=None, **options):
        axes = slice(0, 2) if w is None else slice(1, 3)

        def vectors(each):
            frames, patches = each.shape[: axes.start], np.prod(each.shape[axes])
            return each.reshape(*frames, patches, *(each.shape[axes.stop :] or (1,)))

        options |= {"temporal_weight": w or 0.0, "previous": None if p is None else vectors(p)}
        found = solve_total_variation(vectors(g), weight, Hidden.of(g.shape[axes]), **options)
        return replace(found, image=found.image.reshape(g.shape))

    return solve


@pytest.fixture(scope="session")
def blocks(random_image):
    """Two overlapping blocks in noise, (12, 15)."""

    def draw(seed=0):
        image = np.zeros((12, 15))
        image[2:7, 3:11] = 1.0
        image[6:11, 8:] += 0.5
        return image + 0.2 * random_image(12, 15, seed=seed)

    return draw


def differences(shape, w):
    """Dense differences of (frames, rows, columns): (w dt, dx, dy) of each voxel, row by row."""
    index = np.arange(np.prod(shape)).reshape(shape)
    D = np.zeros((index.size, 3, index.size))
    for axis, factor in enumerate((w, 1, 1)):
        before, after = (np.delete(index, end, axis).ravel() for end in (-1, 0))
        D[before, axis, before], D[before, axis, after] = -factor, factor
    return D.reshape(-1, index.size)


def frames_of(image):
    return image.shape if image.ndim == 3 else (1, *image.shape)


@pytest.fixture(scope="session")
def variation():
    """Isotropic total variation of an image or of a video, differences in time w-fold."""

    def total(image, w=0.0):
        D = differences(frames_of(image), w)
        return np.linalg.norm((D @ image.ravel()).reshape(-1, 3), axis=1).sum()

    return total


@pytest.fixture(scope="session")
def objective(variation):
    """What every proximal operator minimizes."""

    def value(f, g, weight, w=0.0, previous=0.0, l1_weight=0.0):
        pull = l1_weight * np.abs(f - previous).sum()
        return ((f - g) ** 2).sum() + weight * variation(f, w) + pull

    return value


@pytest.fixture(scope="session")
def minimizer():
    """Alternating directions on z = D f and y = f − p, by dense linear algebra."""

    def minimize(
        g, weight, w=0.0, previous=None, l1_weight=0.0, K=None, shape=None, ρ=2.0, iterations=8000
    ):
        """Minimize ‖K f − g‖² + λ‖f‖_TV + λ₂‖f − p‖₁; without K for an image g itself."""
        shape = g.shape if K is None else shape
        K = np.eye(g.size) if K is None else K
        size = K.shape[1]
        D = differences(shape if len(shape) == 3 else (1, *shape), w)
        p = np.zeros(size) if previous is None else previous.ravel()
        tie = ρ if l1_weight else 0.0  # of f to y + p
        inverse = np.linalg.inv(2 * K.T @ K + tie * np.eye(size) + ρ * D.T @ D)
        z = u = np.zeros((size, 3))
        y = v = np.zeros(size)
        for _ in range(iterations):
            f = inverse @ (2 * K.T @ g.ravel() + ρ * D.T @ (z - u).ravel() + tie * (p + y - v))
            a = (D @ f).reshape(-1, 3) + u
            length = np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-300)
            z = a * np.maximum(1 - weight / ρ / length, 0)
            u = a - z
            b = f - p + v
            y = np.sign(b) * np.maximum(np.abs(b) - l1_weight / ρ, 0)
            v = b - y
        return f.reshape(shape)

    return minimize
