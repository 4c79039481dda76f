"""What the machine itself can do, for the benchmark's ratios: memory, products, shadow rays."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np

import periscopy_sim as ps
from experiments.benchmarks.scene import SMALL
from experiments.report import Section, Table
from experiments.setting import Setting
from experiments.timing import median_seconds
from periscopy_sim.numerics.threads import core_count
from periscopy_sim.scenario import Scenario

RAYS = 1 << 23


@dataclass(frozen=True)
class Limits:
    """Rates of this machine, all of its cores working unless said otherwise.

    Attributes
    ----------
    copy
        Bytes read and written a second by copies of 128 MiB.
    single, double
        Floating-point operations a second of products of 2048 x 2048 matrices.
    rays
        Shadow rays a second of Mitsuba alone, from a scene's wall points to its patches.
    """

    copy: float
    single: float
    double: float
    rays: float


@cache
def machine_limits() -> Limits:
    """Measure the machine's limits, once a run; the rays are those of the chair scene."""
    scenario = ps.load_scenario(ps.find_scene("chair"), SMALL)
    return Limits(
        copy=_copy_rate(),
        single=_product_rate(np.float32),
        double=_product_rate(np.float64),
        rays=_ray_rate(scenario),
    )


def machine(_: Setting) -> Section:
    """Show what the machine itself can do."""
    limits = machine_limits()
    rows = [
        ("copies of 128 MiB", f"{limits.copy / 1e9:.0f} GB/s"),
        ("matrix products, single precision", f"{limits.single / 1e9:.0f} GFLOP/s"),
        ("matrix products, double precision", f"{limits.double / 1e9:.0f} GFLOP/s"),
        ("shadow rays of Mitsuba alone", f"{limits.rays / 1e6:.0f} million/s"),
    ]
    return Section(
        "machine", "This machine's limits", tables=[Table("Medians of 7.", ("task", "rate"), rows)]
    )


def _copy_rate() -> float:
    source = np.ones((core_count(), 1 << 24))
    target = np.empty_like(source)
    with ThreadPoolExecutor(core_count()) as pool:

        def copy() -> None:
            list(pool.map(np.copyto, target, source))

        return 2 * source.nbytes / median_seconds(copy, 7)


def _product_rate(precision: type) -> float:
    matrix = np.random.default_rng(0).random((2048, 2048)).astype(precision)
    return 2 * len(matrix) ** 3 / median_seconds(lambda: matrix @ matrix, 7)


def _ray_rate(scenario: Scenario) -> float:
    """Time `ray_test` alone, on rays laid out in memory as A's kernel meets them."""
    import drjit as dr
    import mitsuba as mi

    from periscopy_sim.rendering.scene.load import build_scene

    scene = build_scene(scenario)
    rng = np.random.default_rng(0)
    patches, pixels = len(scenario.patch_centers), len(scenario.wall_points)
    patch = np.arange(RAYS) % patches
    # From all over the wall: rays that pass the occluder take longer.
    pixel = np.arange(RAYS) * pixels // RAYS
    u, v = rng.random((2, RAYS, 1)) - 0.5
    light = (
        scenario.patch_centers[patch]
        + u * scenario.patch_across[patch]
        + v * scenario.patch_up[patch]
    )
    start = scenario.wall_points[pixel]
    towards = light - start
    distance = np.linalg.norm(towards, axis=1, keepdims=True)

    def as_lanes(values: np.ndarray) -> list[np.ndarray]:
        return list(np.ascontiguousarray(values.T, np.float32))

    ray = mi.Ray3f(
        mi.Point3f(as_lanes(start + 1e-4 * towards)),
        mi.Vector3f(as_lanes(towards / distance)),
        mi.Float((distance[:, 0] * (1 - 2e-4)).astype(np.float32)),
        0.0,
        [],
    )
    dr.eval(ray)

    def trace() -> None:
        blocked = scene.ray_test(ray)
        dr.eval(blocked)
        dr.sync_thread()

    return RAYS / median_seconds(trace, 7)
