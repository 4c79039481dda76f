"""The light transport matrix A of any Mitsuba scene, whole or a block of rows at a time.

Column j of A is the photograph of the wall when only patch j shines with unit normal radiance.

Each entry is an integral over a patch, by shadow rays:

    A[i, j] = ∫_patch j f(i; q → camera) E(q → i) V(i, q) cos θ_i cos θ_q / ‖q − i‖² dq

with the wall's BSDF f, the monitor's angular profile E (1 along its normal) and the visibility V.
f of a texture is that of the albedo about the wall point, see `View.point_paint`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Hidden
from periscopy_sim.numerics.validation import InputError, checked
from periscopy_sim.rendering import lcd, load, wall
from periscopy_sim.rendering.variant import LANES, dr, mi, require_vectorized
from periscopy_sim.scene import EmissionProfile
from periscopy_sim.view import Geometry

Strata = Literal["midpoint", "gauss", "jittered"]

SHADOW_EPSILON = 1e-4
"""Fraction of a shadow ray left out at either end, so that it misses the surfaces it joins."""


class Kernel:
    """The entries A[pixel, patch] of one hidden surface of a scenario, as Dr.Jit arrays.

    Called with numbers of pixels in the photograph and of the surface's patches, and a seed, it
    returns an entry for each lane: the mean over the pixel's wall points of sums over the patch's
    samples.
    """

    def __init__(self, scenario: Geometry, name: str, samples: int, strata: Strata) -> None:
        source, view = scenario.scene.source, scenario.view
        self._scene, self._opaque = source.built(scenario.scene), source.opaque(scenario.scene)
        self._camera = wall.camera_of(self._scene, view.camera)
        self._wall = wall.shape_of(self._scene, view.wall)
        self._surface, self._shape = scenario.hidden[name], wall.shape_of(self._scene, name)
        self._profile = profile_of(self._shape.emitter(), scenario.scene.emission[name])
        self._samples, self._strata = samples, strata
        self._film, self._across = scenario.view.shape, scenario.view.across
        self._albedo = None if view.reflectance is None else float(view.even.albedo)
        self._paint = None
        if view.texture is not None:
            paint = np.ones((int(np.prod(view.shape)), view.texture.shape[1]), np.float32)
            paint[view.numbers] = view.point_paint
            self._paint = mi.Float(paint.ravel())
        # The centres of the pixels serve every patch: found once.
        self._centres = self._seen_at(dr.arange(mi.UInt32, int(np.prod(self._film))), 0.5, 0.5)
        dr.eval(self._centres)

    def __call__(self, pixel: Any, patch: Any, seed: Any) -> Any:
        """Return entries of A."""
        key = _hash(_hash(pixel, seed), patch)

        def at_wall_point(p: Any) -> Any:
            point_key = _hash(key, p)
            si = self._wall_point(pixel, p)
            light = _sum(self._samples, lambda k: self._transfer(si, patch, k, point_key))
            if self._paint is None:
                return light
            return light * dr.gather(mi.Float, self._paint, pixel * self._across**2 + p)

        total, (rows, columns) = _sum(self._across**2, at_wall_point), self._surface.shape
        return total / (self._samples * self._across**2 * rows * columns)

    def _transfer(self, si: Any, patch: Any, index: Any, key: Any) -> Any:
        """Integrand at one sample of the patch, per unit of the hidden surface's UV square."""
        surface, (down, across) = self._surface, _factor(self._samples)
        offset = self._within(index, down, across, key)
        row, column = patch // surface.shape[1], patch % surface.shape[1]
        uv = load.patch_uv(row, column, surface.shape, surface.mirrored, offset)
        light = wall.surface_at(self._shape, mi.Point2f(*uv))
        to_light = light.p - si.p
        squared_distance = dr.squared_norm(to_light)
        direction = to_light * dr.rcp(dr.sqrt(squared_distance))
        cos_emission = -dr.dot(light.n, direction)
        area = dr.norm(dr.cross(light.dp_du, light.dp_dv))
        value = self._reflected(si, si.to_local(direction))
        value *= self._profile(light, -direction) * cos_emission * area / squared_distance
        # The segment, shortened at both ends. Mitsuba's spawn_ray_to would lift its start off the
        # wall by some 0.2 mm, which shifts every shadow's edge.
        start = dr.fma(to_light, SHADOW_EPSILON, si.p)
        segment = mi.Ray3f(start, to_light, 1 - 2 * SHADOW_EPSILON, 0.0, [])
        # Traced for every lane: a mask costs more than the few rays that it saves.
        visible = ~self._opaque.ray_test(segment)
        lit = visible & light.is_valid() & (cos_emission > 0) & (value > 0)
        return dr.select(lit, value, 0)

    def _reflected(self, si: Any, direction: Any) -> Any:
        """Return f cos θ_i of the wall for light from a direction in its frame."""
        if self._albedo is not None:
            cosine = dr.mulsign(direction.z, si.wi.z)
            return dr.maximum(cosine, 0) * mi.Float(self._albedo / np.pi)
        # Not dr.mean, which writes the number of lanes into the kernel, and into the last bit.
        return dr.sum(self._wall.bsdf().eval(mi.BSDFContext(), si, direction)) / 3

    def _wall_point(self, pixel: Any, index: Any) -> Any:
        """Where the camera sees the wall, by the number of a point of the pixel."""
        if self._across == 1:
            return dr.gather(type(self._centres), self._centres, pixel)
        # Light is smooth within a pixel: middles err less than jitter adds noise.
        return self._seen_at(pixel, *self._within(index, self._across, self._across))

    def _seen_at(self, pixel: Any, y: Any, x: Any) -> Any:
        rows, columns = self._film
        film = mi.Point2f((pixel % columns + x) / columns, (pixel // columns + y) / rows)
        ray, _ = self._camera.sample_ray(0.0, 0.0, film, mi.Point2f(0.5))
        return self._scene.ray_intersect(ray, +mi.RayFlags.All, True)

    def _within(self, index: Any, down: int, across: int, key: Any = None) -> tuple[Any, Any]:
        """Position in the unit square of sample number `index` of down x across strata.

        It jitters by a key, without one not at all.
        """
        row, column = index // across, index % across
        if key is not None and self._strata == "jittered":
            bits = _scrambled(key, 2 * index)
            jitter = [(mi.Float(half) + 0.5) / (1 << 16) for half in (bits >> 16, bits & 0xFFFF)]
        else:
            jitter = [self._placed(row, down), self._placed(column, across)]
        return (mi.Float(row) + jitter[0]) / down, (mi.Float(column) + jitter[1]) / across

    def _placed(self, index: Any, count: int) -> Any:
        """Position in stratum number `index` of `count` along an axis, where nothing jitters it."""
        if self._strata == "gauss" and count % 2 == 0:
            # Gauss and Legendre's points lie 1/√3 of a stratum's width off the middle of a pair.
            return dr.select(index % 2 == 0, mi.Float(1 - 1 / np.sqrt(3)), mi.Float(1 / np.sqrt(3)))
        return mi.Float(0.5)


def _sum(count: int, term: Callable[[Any], Any]) -> Any:
    """Sum term(0) + ... + term(count - 1) in a loop within the kernel."""
    if count == 1:
        return term(mi.UInt32(0))  # a loop would keep the loop within it from being optimized
    total, _ = dr.while_loop(
        (mi.Float(0), mi.UInt32(0)),
        lambda _, k: k < count,
        lambda total, k: (total + term(k), k + 1),
    )
    return total


def profile_of(emitter: Any, known: EmissionProfile | None) -> Callable[[Any, Any], Any]:
    """Return the radiance of a point of an emitter in a direction, relative to the normal's.

    Its closed form is taken where it is known.
    """

    def evaluated(light: Any, direction: Any) -> Any:
        # eval_parameterization leaves the tangents unnormalized.
        across = dr.normalize(light.dp_du)
        light.sh_frame = mi.Frame3f(across, dr.cross(light.n, across), light.n)
        light.wi = light.to_local(direction)
        towards = emitter.eval(light).x
        light.wi = mi.Vector3f(0, 0, 1)
        return towards / emitter.eval(light).x

    if known is None:
        return evaluated
    exponents = known.vertical, known.horizontal
    return lambda light, direction: lcd.falloff_about(light, direction, exponents)


def _factor(count: int) -> tuple[int, int]:
    """Cut a unit square into `count` equal strata, as square as its divisors allow."""
    down = next(n for n in range(int(np.sqrt(count)), 0, -1) if count % n == 0)
    return down, count // down


def _hash(a: Any, b: Any) -> Any:
    """Turn two integers into random bits."""
    # Mitsuba's default of 4 rounds leaves neighbours correlated by up to 0.4.
    return mi.sample_tea_32(a, b, 6)[0]


def _scrambled(key: Any, index: Any) -> Any:
    """Turn the index of a sample into random bits, the key being random already.

    A multiply and xor-shift hash (C. Wellons, "Prospecting for hash functions", 2018) of numbers a
    golden ratio apart: a tenth of `_hash`'s work, once for each ray.
    """
    bits = key + index * mi.UInt32(0x9E3779B9)
    bits = (bits ^ (bits >> 16)) * mi.UInt32(0x7FEB352D)
    bits = (bits ^ (bits >> 15)) * mi.UInt32(0x846CA68B)
    return bits ^ (bits >> 16)


def render_transport(
    scenario: Geometry,
    *,
    samples: int = 16,
    strata: Strata = "jittered",
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float32]:
    """Render the light transport matrix of direct light by shadow rays.

    Each patch is cut into as many strata as samples; one shadow ray goes from the wall point to
    each. Light that bounces is added by `add_bounces`.

    A pixel is its centre, or the mean over the points of `Geometry.averaged`; the film's own
    reconstruction filter is not used.

    Parameters
    ----------
    scenario
        The scene.
    samples
        Samples of a patch for each wall point.
    strata
        Where in its stratum a sample lies: ``"jittered"`` (unbiased; noise of independent entries),
        or, without noise but with penumbrae in steps, ``"midpoint"`` or ``"gauss"``: Gauss and
        Legendre's two points of each pair of strata along an axis, exact for cubic integrands; of
        an odd number the middles.
    seed
        Seed of the jitter. The same seed and variant give the same bytes.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray
        A, (M, N) float32, radiance sent to the camera for each unit of a patch's normal radiance.
        Multiplied by the channel's `Geometry.channel_gain` where the wall is coloured.

    Raises
    ------
    SceneError
        If no light of the monitor reaches the wall.
    VariantError
        In scalar variants.
    """
    rendered = RenderedTransport(scenario, samples, strata, seed)
    A = np.empty(rendered.shape, np.float32)
    for rows, block in rendered.row_blocks():
        A[rows] = block
        if progress is not None:
            progress(rows.stop / len(A))
    require_light(A, scenario)
    return A


def require_light(A: NDArray[np.float32], scenario: Geometry) -> None:
    """Check that every hidden surface lights a pixel beyond rounding; else raise a SceneError."""
    least = float(np.finfo(A.dtype).eps) * A.max(initial=0)
    for name, part in scenario.hidden.slices.items():
        if not A[:, part].max(initial=0) > least:
            raise SceneError(
                f"scene '{scenario.path}': no light of '{name}' reaches the wall; look for what "
                "stands between them, or an emitter that shines in other directions"
            )


@dataclass(frozen=True, eq=False)
class RenderedTransport:
    """The matrix that `render_transport` gives for the same arguments, a block of rows at a time.

    `transport_operator` makes a SciPy linear operator of it, for solvers that pass over A. Every
    pass traces all the rays again, and draws the same samples. Parameters that `render_transport`
    rejects are a ValueError.
    """

    scenario: Geometry
    samples: int = 16
    strata: Strata = "jittered"
    seed: int = 0

    def __post_init__(self) -> None:
        checked("samples", self.samples, "rays")
        if self.strata not in get_args(Strata):
            raise ValueError(f"strata '{self.strata}' are not known; use one of {get_args(Strata)}")
        hidden, scene = self.scenario.hidden, self.scenario.scene
        traced = Hidden.of_scene(scene, hidden.shapes)
        if not np.allclose(traced.centers, hidden.centers, rtol=1e-4, atol=1e-6):
            raise InputError(
                f"rays meet the hidden surfaces where scene '{scene.path}' has them, not where the "
                "given ones are; move them in the scene, or compute A by areas"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""
        return self.scenario.transport_shape

    def row_blocks(
        self, pixels: NDArray[np.integer[Any]] | None = None
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield every row, or those of some pixels, once: a slice and its (rows, N) entries.

        Scalar variants raise a `VariantError`.
        """
        require_vectorized("the transport matrix by rays")
        hidden = self.scenario.hidden
        kernels = [Kernel(self.scenario, name, self.samples, self.strata) for name in hidden]
        chosen = np.arange(self.shape[0]) if pixels is None else pixels
        numbers = mi.UInt32(self.scenario.view.numbers[chosen].astype(np.uint32))
        work = max(1, self.samples * self.scenario.view.across**2 // RenderedTransport.samples)
        height = max(1, LANES // work // hidden.patches)
        for start in range(0, len(chosen), height):
            rows = slice(start, min(start + height, len(chosen)))
            # Opaque, so that all blocks share one compiled kernel.
            first, parts = dr.opaque(mi.UInt32, start), []
            for k, (entries, surface) in enumerate(zip(kernels, hidden.values(), strict=True)):
                patches = len(surface.centers)
                lane = dr.arange(mi.UInt32, (rows.stop - start) * patches)
                pixel = dr.gather(mi.UInt32, numbers, lane // patches + first)
                values = entries(pixel, lane % patches, dr.opaque(mi.UInt32, self.seed + k))
                parts.append(np.array(values).reshape(-1, patches))
            yield rows, np.hstack(parts) if len(parts) > 1 else parts[0]

    def white(self, pixels: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return the light, (K,), that a white hidden image sends to some pixels."""
        blocks = self.row_blocks(pixels)
        return np.concatenate([block.sum(axis=1, dtype=np.float64) for _, block in blocks])
