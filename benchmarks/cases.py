"""Photographs of a suite's geometry, composed of what is rendered, and what methods are told.

The photographs come through a light transport matrix of the true geometry, averaged over each
pixel's area, by four times the rays and another seed; the matrix that methods get has one wall
point a pixel, as `ps.render_transport` renders it for everyone. So no method is given the matrix
that made the photographs. The hidden image is constant over each patch, as methods take
it to be; light that bounces between things is left out; ambient light is path traced.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from benchmarks.suites import Suite, crop, geometry
from experiments.paper.moving_scene import clip
from experiments.setting import kept, package_sha256
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.pictures import area_average
from periscopy_sim.storage.provenance import scene_sha256
from periscopy_sim.storage.rasters import srgb_decode

Array = NDArray[np.float64]

AMBIENT_ERROR = 1e-3
"""Relative error of a pixel at which rendering ambient light stops: the noise at 60 dB."""

RENDERED = Path("out/leaderboard/rendered")
"""Where ambient light is kept between runs, below the working folder."""

_TRUE_SEED = 1


@dataclass(frozen=True, eq=False)
class Case:
    """One geometry of a suite: what a method gets, and what it is judged by.

    Attributes
    ----------
    suite
        The suite.
    scenario
        The scene as methods are told it.
    A, B
        (M, N) and (M, 512) matrices of that scene, by its own numbers.
    photographs
        (K, rows, columns, 3), of mean 1, with noise.
    truths
        (K, R, C, 3) hidden images in [0, 1], linear: not for methods.
    names
        Of the K cells: image, light and ratio.
    """

    suite: Suite
    scenario: Scenario
    A: NDArray[np.float32]
    B: Array
    photographs: Array
    truths: Array
    names: tuple[str, ...]


def case(suite: Suite, number: int, rendered: Path = RENDERED) -> Case:
    """Render one geometry of a suite; ambient light is read where it was rendered before."""
    drawn = geometry(suite, number)
    true = ps.load_scenario(suite.scene, suite.hidden, drawn.true)
    told = ps.load_scenario(suite.scene, suite.hidden, drawn.told)
    transport = ps.render_transport(true.averaged(2), seed=_TRUE_SEED)
    truths, photographs, names = [], [], []
    for image, truth in hidden_images(suite, number):
        light = (transport @ truth.reshape(-1, 3)).reshape(*true.photograph_shape, 3)
        for place in suite.lights:
            ambient = np.flip(ambient_light(place, true, rendered), drawn.flips)
            for ratio in suite.ratios:
                name = f"{image}, {place}, SBR {ratio:g}"
                exposed = ps.composite(light * true.channel_gain, ambient, ratio)
                photographs.append(ps.add_noise(exposed, suite.snr, _seed(suite, number, name)))
                truths.append(truth)
                names.append(name)
    return Case(
        suite,
        told,
        ps.render_transport(told),
        ps.point_light_backgrounds(told),
        np.stack(photographs),
        np.stack(truths),
        tuple(names),
    )


def hidden_images(suite: Suite, number: int) -> list[tuple[str, Array]]:
    """Return names and hidden images, (R, C, 3), of a suite's geometry."""
    if suite.frames:
        film = clip(suite.hidden, suite.frames, start=2.5 * number)
        return [(f"frame {k}", frame) for k, frame in enumerate(film)]
    return [(name, _hidden_image(suite, name)) for name in suite.images]


def ambient_light(place: str, scenario: Scenario, rendered: Path) -> Array:
    """Return the wall under a shipped place's light, (rows, columns, 3); the camera never moves."""
    scene = f"ambient/{place}"
    depends = {
        "scene_sha256": scene_sha256(ps.find_scene(scene)),
        "wall_sha256": hashlib.sha256(np.round(scenario.view.centers, 9).tobytes()).hexdigest(),
        "package_sha256": package_sha256(),
    }
    render = partial(ps.render_background, scene, scenario, target=AMBIENT_ERROR, seed=0)
    return kept(rendered / f"{place}.exr", depends, lambda: render().photograph)


def _hidden_image(suite: Suite, name: str) -> Array:
    kind, _, rest = name.rpartition(":")
    if not kind:
        return ps.read_hidden_image(ps.find_image(name), suite.hidden)
    return area_average(srgb_decode(crop(suite, rest) / 255), suite.hidden)


def _seed(*identity: Any) -> int:
    text = ", ".join(part.name if isinstance(part, Suite) else str(part) for part in identity)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8])
