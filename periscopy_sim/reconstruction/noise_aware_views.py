"""Several photographs of one hidden scene, each by a camera of its own.

    y_v = s_v A_v f + B_v b_v + n_v

The exposures s_v are unknown, 1 of the first view; each view has its own ambient light and noise.
Each view is fitted alone first: this gives its noise σ_v, its corrections and an image. Then

    s_v A⊥_v/σ_v  and  y⊥_v/σ_v,  view below view,

are one problem, that of the noise-aware method for a camera that sees all these pixels. It is times
σ_1, so that the image is in units of the first photograph. In a view σ_v stands for the geometric
mean over the channels; the ratios of channels follow from all views together.

The exposures maximize the evidence of images f ~ N(0, K⁻¹/μ_c), K = ∇ᵀ∇ + I, in channel c:

    log p(y⊥|s, μ) = Σ_c ½ (m log μ_c − log det H_c + d_cᵀH_c⁻¹d_c),
    H_c = μ_c I + Σ_v s_v² G_v/σ_vc²,  d_c = Σ_v s_v WᵀA⊥_vᵀy⊥_vc/σ_vc²,  G_v = WᵀA⊥_vᵀA⊥_v W,

m patterns W, with WᵀKW = I, being those that the views show best. Alternating with the image would
need hundreds of images where the views show different parts of the scene. The assumption
that such images are equally bright constrains exposures only to a factor of two.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from threadpoolctl import threadpool_limits

from periscopy_sim.model.fit import PRECISION, Fit, FittedPhotograph
from periscopy_sim.model.spectral_basis import laplacian
from periscopy_sim.model.transport_operator import ROUNDING
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Note, Report, StillMethod
from periscopy_sim.reconstruction.noise_aware import NoiseAware, NoiseAwareReconstruction

STRONGEST = 150
"""Patterns of each view in which exposures are estimated. For two walls (64 x 64 pixels, 29 x 36
patches, 60 and 55 dB) 100 move the exposure by 0.7 standard errors, 200 by 0.1, against 400."""

DISTINCT = 1e-6
"""Squared length of a pattern beside all others, over the longest, below which they contain it."""

RANGE = np.log(1000.0)
"""Standard deviation of the logarithm of μ about where its search starts."""

BRIGHTNESS = np.log(2.0)
"""Standard deviation of the logarithm of how bright the parts of a scene are that views see; that
of an exposure about the one of views that see parts alike."""

MOST_STEPS, DECREMENT = 200, 1e-4
"""Of Newton's method; squared distance from the maximum, in standard errors, that is none."""

RIDGE = 1e-3
"""Over the mean of a view's information, in the image that μ starts from."""

UNCERTAIN = 0.05
"""Relative standard error of an exposure above which a report warns of it."""


class NoiseAwareViews:
    """Recover the hidden image of several views of one scene; see the module.

    Parameters
    ----------
    views
        The noise-aware method fitted to each view, by camera. Their settings are those of the
        first.

    Raises
    ------
    InputError
        If there is no view, or their hidden images have different sizes.
    """

    def __init__(self, views: Mapping[str, NoiseAware]) -> None:
        if not views:
            raise InputError("give one view at least")
        self.views = dict(views)
        first = next(iter(views.values())).hidden
        for camera, view in views.items():
            if view.hidden.shapes != first.shapes:
                raise InputError(
                    f"view '{camera}' has {view.hidden.sizes} hidden patches, the first one "
                    f"{first.sizes}; give all views the same hidden image"
                )

    @classmethod
    def for_scene(
        cls,
        scenarios: Mapping[str, Any],
        A: Mapping[str, Any],
        B: Mapping[str, Any],
        **settings: Any,
    ) -> Self:
        """Fit to views of one scene: the scenarios, A and B of each by camera.

        The settings are those of `NoiseAware`. Scenarios of different scenes are an InputError.
        """
        first: Any = next(iter(scenarios.values()), None)
        for camera, each in scenarios.items():
            if (each.path, each.parameters) != (first.path, first.parameters):
                raise InputError(
                    f"views of different scenes: the first is of {first!r}, '{camera}' of "
                    f"{each!r}; give cameras of one scene"
                )
        return cls(
            {n: NoiseAware.for_scene(s, A[n], B.get(n), **settings) for n, s in scenarios.items()}
        )

    def reconstruct(self, photographs: Mapping[str, Photograph | Image]) -> NDArray[np.float64]:
        """Return the hidden image, (R, C, channels), of a photograph by each camera."""
        return self.solve(photographs).image

    def solve(self, photographs: Mapping[str, Photograph | Image]) -> NoiseAwareReconstruction:
        """Return the hidden image and how it came about.

        A photograph of another camera, one that is missing, or other numbers of channels are an
        InputError; further errors are those of `NoiseAware.reconstruct`.
        """
        if photographs.keys() != self.views.keys():
            raise InputError(
                f"there are photographs of {', '.join(photographs)}, the views are "
                f"{', '.join(self.views)}; give one of each"
            )
        alone = {camera: view.solve(photographs[camera]) for camera, view in self.views.items()}
        seen, planes = [each.photograph for each in alone.values() if each.photograph], []
        for camera, corrected in zip(alone, seen, strict=True):
            photograph, plane, fit = photographs[camera], corrected.planes, corrected.fit
            y = photograph.values if isinstance(photograph, Photograph) else photograph
            whole, rest = map(fit.project_out, (fit.vectors(y).T, plane))
            # A gain keeps the light of its photograph, whose exposure it would take over else.
            planes.append(plane * (np.vdot(whole, rest) / (np.vdot(rest, rest) or 1.0)))
            if len(plane) != len(planes[0]):
                raise InputError(
                    f"the photograph of '{camera}' has {len(plane)} channels, the first one "
                    f"{len(planes[0])}; give all views the same channels"
                )
        noises = np.array([each.noise for each in alone.values()])
        together, fits = copy(next(iter(self.views.values()))), [each.fit for each in seen]
        vector = together.hidden.vector
        sizes = [float(np.linalg.norm(vector(each.image))) for each in alone.values()]
        start = np.divide(sizes, sizes[0]) if min(sizes) > 0 else np.ones(len(sizes))
        with threadpool_limits(1):  # the bits then do not depend on the number of cores
            s, errors = find_exposures(*seen_patterns(fits, planes), noises, start)
            scales = np.exp(np.mean(np.log(noises[0] / noises), axis=1))  # σ_1/σ_v
            together.fit = Fit.of_views(fits, s * scales)
            scaled = [scale * plane for scale, plane in zip(scales, planes, strict=True)]
            stack = FittedPhotograph(np.hstack(scaled), together.fit)
            solution, _ = together.recover(stack.evidence)
        solution.warn_unless_converged()
        exposures = dict(zip(alone, s.tolist(), strict=True))
        of_each = dict(zip(alone, errors.tolist(), strict=True))
        return replace(
            solution, photograph=stack, views=alone, exposures=exposures, exposure_errors=of_each
        )

    def report(
        self, photographs: Mapping[str, Photograph | Image], solution: NoiseAwareReconstruction
    ) -> tuple[Report, dict[str, Report]]:
        """Return what is known of the image, and of each view, by camera.

        The first report has standard errors, warnings of uncertain exposures, and each view's image
        alone as its stages; that of a view has its residual and verdict.
        """
        assert solution.photograph is not None
        reports, together = {}, copy(next(iter(self.views.values())))
        together.fit = solution.photograph.fit
        for camera, view in self.views.items():
            own = self.of_view(camera, solution)
            report = StillMethod.report(view, photographs[camera], own)
            reports[camera] = replace(report, notes=own.notes())
        whole = together.with_errors(Report(numbers=solution.numbers()), solution)
        uncertain = {n: 100 * e for n, e in solution.exposure_errors.items() if e > UNCERTAIN}
        warnings = [Note("exposure", {"camera": n, "percent": e}) for n, e in uncertain.items()]
        stages = [(f"{camera} alone", alone.image) for camera, alone in solution.views.items()]
        return replace(whole, warnings=warnings, stages=stages), reports

    def of_view(self, camera: str, solution: NoiseAwareReconstruction) -> NoiseAwareReconstruction:
        """Return a view's own solution with the image of all views, in the view's exposure."""
        hidden = self.views[camera].hidden
        light = solution.exposures[camera] * hidden.vector(solution.image)
        return replace(solution.views[camera], image=hidden.image(light))


def seen_patterns(fits: Sequence[Fit], planes: Sequence[Array]) -> tuple[Array, Array]:
    """Return G, (V, m, m), and WᵀA⊥ᵀ y⊥, (V, C, m), for the patterns that any view shows best.

    The planes are those of each view's photograph, (C, M').
    """
    rows = np.concatenate([fit.patterns.rows[fit.visible][-STRONGEST:] for fit in fits])
    rows = rows.astype(np.float64)
    lengths, V = np.linalg.eigh(rows @ (laplacian(fits[0].hidden.differences) @ rows.T))
    kept = lengths > DISTINCT * lengths[-1]
    W = rows.T @ (V[:, kept] / np.sqrt(lengths[kept]))
    shown = [fit.operator.matmat(W) for fit in fits]
    products = [y @ each for y, each in zip(planes, shown, strict=True)]
    return np.array([each.T @ each for each in shown]), np.array(products)


def find_exposures(G: Array, d: Array, σ: Array, start: Array) -> tuple[Array, Array]:
    """Return the exposures, (V,), 1 first, and their relative standard errors, from a start.

    G and d are those of `seen_patterns`, the σ, (V, C), those of the photographs' noise. To the
    variance of an exposure adds that of A's rounding, and that of the prior's brightness by the
    square of the part of the information that the prior has. If Newton's method does not converge,
    it is an InputError.
    """
    count, channels, m = d.shape
    if not d.any():  # black photographs
        return np.ones(count), np.append(0.0, np.full(count - 1, BRIGHTNESS))
    G = G + ROUNDING * np.trace(G, axis1=1, axis2=2)[:, None, None] / m * np.eye(m)
    ridge = G[0] + RIDGE * np.trace(G[0]) / m * np.eye(m)
    sizes = np.sum(linalg.solve(ridge, d[0].T, assume_a="pos") ** 2, axis=0)
    known = np.where(sizes > 0, sizes, m)  # a black channel shows no size
    begin = np.log(np.append(start[1:], m / known))
    widths = np.append(np.full(count - 1, BRIGHTNESS), np.full(channels, RANGE))
    x, step, least = begin, np.zeros(len(begin)), np.inf
    for _ in range(MOST_STEPS):
        value, slopes, curvature, of_prior = evidence_of(x + step, begin, widths, G, d, σ)
        if value > least + ROUNDING * abs(least):
            step = step / 2
            continue
        x, least = x + step, value
        λ, V = np.linalg.eigh(curvature)
        step = -V @ (V.T @ slopes / np.maximum(np.abs(λ), 1 / RANGE**2))
        if λ[0] > 0 and -step @ slopes < DECREMENT:
            break
        step /= max(1.0, np.abs(step / widths).max())
    else:
        raise InputError(
            "the exposures of the views cannot be estimated: the evidence has no maximum near "
            "those of each view alone; recover each view alone, and compare their residuals"
        )
    variances = np.diag(np.linalg.inv(curvature))[: count - 1]
    by_prior = np.minimum(2 * variances * of_prior[1:], 1)
    errors = np.sqrt(variances + PRECISION**2 + (BRIGHTNESS * by_prior) ** 2)
    return np.exp(np.append(0.0, x[: count - 1])), np.append(0.0, errors)


def evidence_of(
    x: Array, begin: Array, widths: Array, G: Array, d: Array, σ: Array
) -> tuple[float, Array, Array, Array]:
    """Return −log p, its slopes and curvature by the logarithms x of s_2, … and of μ, and more.

    A priori x has these widths about where the search begins; G, (V, m, m), d, (V, C, m), and σ,
    (V, C), are those of the views. The last is the information on log s that the prior has, (V,).
    """
    (count, channels, m), size = d.shape, len(d) + d.shape[1]
    s, μ = np.exp(np.append(0.0, x[: count - 1])), np.exp(x[count - 1 :])
    value, slopes, curvature = 0.0, np.zeros(size), np.zeros((size, size))
    of_prior = np.zeros(count)
    for c in range(channels):
        light = (s / σ[:, c]) ** 2
        parts = np.concatenate([light[:, None, None] * G, μ[c] * np.eye(m)[None]])
        data = (s / σ[:, c] ** 2)[:, None] * d[:, c]
        try:
            factor = linalg.cho_factor(parts.sum(axis=0))
        except (linalg.LinAlgError, ValueError) as error:
            raise InputError(f"the exposures of the views cannot be estimated: {error}") from None
        f = linalg.cho_solve(factor, data.sum(axis=0))
        shown = parts @ f
        shares = np.array([linalg.cho_solve(factor, part) for part in parts])  # H⁻¹ parts
        log_ratio = 2 * np.sum(np.log(np.diag(factor[0]))) - m * np.log(μ[c])
        value += float(log_ratio - f @ data.sum(axis=0)) / 2
        powers = np.append(np.full(count, 2.0), 1.0)  # of s and μ in their parts of H
        rests = np.append(data, np.zeros((1, m)), axis=0) - powers[:, None] * shown
        both = np.trace(shares, axis1=1, axis2=2) + shown @ f
        used = [*range(count), count + c]
        slopes[used] += powers * both / 2 - np.append(data @ f, 0.0)
        slopes[count + c] -= m / 2
        crossed = np.einsum("aij,bji->ab", shares, shares) * np.outer(powers, powers) / 2
        crossed += rests @ linalg.cho_solve(factor, rests.T)
        diagonal = powers**2 * both / 2 - np.append(data @ f, 0.0)
        curvature[np.ix_(used, used)] += np.diag(diagonal) - crossed
        of_prior += shown[:count] @ linalg.cho_solve(factor, shown[count])
    away = (x - begin) / widths
    value += float(away @ away) / 2
    slopes, curvature = slopes[1:] + away / widths, curvature[1:, 1:] + np.diag(widths**-2.0)
    return value, slopes, curvature, of_prior
