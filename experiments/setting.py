"""The paper's experiment: the chair scene, its matrices, photographs and ambient light.

What takes long to render is kept in the folder of the run and read again by the next figure.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.methods import Name
from periscopy_sim.reconstruction.registry import RAYS
from periscopy_sim.rendering.load import check_media
from periscopy_sim.rendering.nodes import SceneNodes
from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC, find_scene
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.storage.provenance import scene_sha256
from periscopy_sim.storage.rasters import read_exr, write_exr

Array = NDArray[np.float64]
SNR = 60.0
"""dB (Sec. 4.1)."""

AMBIENT_ERROR = 1e-3
"""Relative error of a pixel at which rendering ambient light stops. P lets so little of it through
that at SBR 0.05 it reaches at most 6 % of the sensor's noise, and adds 0.3 % to its variance (two
renderings of each of the windows, the corridor and the desk lamps compared)."""

FREE_OF_NOISE: Any = {"samples": 64, "strata": "midpoint"}
"""Of A: jittered rays' noise lifts its smallest singular values and speckles the rows of P."""

GLASS = "stained_glass"
NO_BEAM = f"{GLASS}_no_beam"
"""The stained glass seen from the wall, without the sun through it that falls on the wall."""

WITHOUT_BEAM = {"sunbeam": "0"}


@dataclass(frozen=True, eq=False)
class Measured:
    """A photograph without ambient light and what the monitor showed."""

    signal: Array  # (rows, columns, 3), linear
    truth: Array  # (R, C, 3) in [0, 1], linear
    kind: str  # how it was made, in a word


@dataclass(eq=False)
class FittedScene:
    """A scene at one resolution, and what is made from it, each when first asked.

    By default A has random rays, as the paper's method wants.
    """

    scene: str | Path  # its file, or a shipped one's name
    hidden: tuple[int, int]  # (R, C) of the hidden image
    seed: int = 0
    parameters: Mapping[str, str | float] | None = None  # values of the scene's ``<default>``s
    light: ps.Light = ps.Light(samples=RAYS)  # noqa: RUF009  it is frozen

    @cached_property
    def scenario(self) -> Scenario:
        """The scene, which makes A, B, photographs and methods."""
        return ps.load_scenario(
            find_scene(self.scene), self.hidden, self.parameters, light=self.light, seed=self.seed
        )

    @property
    def A(self) -> NDArray[np.float32]:  # noqa: N802 (the paper's name)
        """(M, N) light transport matrix."""
        A: NDArray[np.float32] = self.scenario.A
        return A

    @property
    def B(self) -> Array:  # noqa: N802
        """(M, 512) the paper's point lights (Sec. 3.1)."""
        B: Array = self.scenario.B
        return B

    @property
    def preconditioned(self) -> Any:
        """The paper's method, fitted, P explicit."""
        return self.method("preconditioned")

    @property
    def noise_aware(self) -> Any:
        """The noise-aware method, fitted."""
        return self.method("noise-aware")

    def method(self, name: Name, photograph: ps.Photograph | None = None) -> Any:
        """Return a method, fitted to the scene as if its numbers had no errors."""
        return self.scenario.method(name, photograph, errors={})


def chair(hidden: tuple[int, int], seed: int = 0, **options: Any) -> FittedScene:
    """Return the chair scene at one resolution; the options are those of `FittedScene`."""
    return FittedScene("chair", hidden, seed, **options)


class Setting(FittedScene):
    """The chair scene with 36 x 29 hidden patches, its photographs and its ambient light."""

    image = "mushroom"

    def __init__(
        self,
        out: Path,  # folder of the run
        real: Path | None = None,  # NPZ of a real ``photograph`` and its ``hidden`` image
        rendered: Path | None = None,  # folder of what takes long to render; None: `out`/rendered
    ) -> None:
        super().__init__("chair", (29, 36))
        self.out = out
        self.real = real
        self.rendered = rendered or out / "rendered"

    @cached_property
    def measured(self) -> Measured:
        """The real photograph where there is one, else one rendered, all bounces."""
        if self.real is not None:
            signal = ps.read_photograph(self.real, self.scenario.photograph_shape).values
            return Measured(signal, ps.read_hidden_image(self.real, self.hidden), "real")
        truth = self.scenario.image(self.image)

        def render() -> Array:
            return self.scenario.photograph(truth).values

        return Measured(self.kept(self.image, "chair", render), truth, "rendered")

    def identity(self) -> bytes:
        """Return the real photograph's bytes; one that cannot be read is a PhotographError."""
        if self.real is None:
            return b""
        self.measured  # noqa: B018 (it is refused before hours of work)
        return self.real.read_bytes()

    def backgrounds(self, names: Sequence[str] = REALISTIC) -> dict[str, Array]:
        """Photographs of the board under ambient light: the realistic conditions, or others."""
        ambient = partial(self.scenario.ambient, target=AMBIENT_ERROR)
        return {name: ambient(name).photograph for name in names}

    @property
    def adversarial(self) -> dict[str, Array]:
        """The two adversarial conditions (Fig. 5), the window also without its sunbeam."""
        scene, lit = f"ambient/{GLASS}", self.backgrounds(ADVERSARIAL)

        def render() -> Array:
            return ps.render_background(
                scene, self.scenario, WITHOUT_BEAM, target=AMBIENT_ERROR, seed=self.seed
            ).photograph

        return {GLASS: lit.pop(GLASS), NO_BEAM: self.kept(NO_BEAM, scene, render), **lit}

    def place(self, name: str) -> Array:
        """Picture of the place of an ambient condition, to look at: (225, 300, 3)."""
        scene, parameters = (GLASS, WITHOUT_BEAM) if name == NO_BEAM else (name, {})
        path = f"ambient/{scene}"
        return self.kept(f"{name}_wide", path, lambda: render_place(path, parameters))

    def kept(self, name: str, scene: str, render: Callable[[], Array]) -> Array:
        """Return the picture of a name: read, if this package rendered it of the same scenes."""
        record = {
            "scene_sha256": scene_sha256(ps.find_scene(scene)),
            "chair_sha256": scene_sha256(ps.find_scene("chair")),
            "package_sha256": package_sha256(),
            "seed": str(self.seed),
        }
        return kept(self.rendered / f"{name}.exr", record, render)


def kept(file: Path, depends: Mapping[str, str], render: Callable[[], Array]) -> Array:
    """Render a picture, (rows, columns, 3), or read the file that holds it.

    The function reads the file if its metadata are what the picture `depends` on.
    """
    if not (file.is_file() and depends.items() <= read_exr(file)[1].items()):
        with staged_file(file) as staged:
            write_exr(staged, render(), depends)
    return np.asarray(read_exr(file)[0], np.float64)


def render_place(
    path: str | Path,
    parameters: Mapping[str, str] | None = None,
    *,
    size: tuple[int, int] = (225, 300),
    samples: int = 64,
) -> Array:
    """Path trace a place as the sensor ``wide`` of its scene sees it: (*size, 3) radiance."""
    ps.use_variant()
    nodes = SceneNodes(find_scene(path), parameters, required={"wide": "Sensor"})
    check_media(nodes)
    nodes.average_pixels(size, sensor="wide")
    scene = nodes.instantiate()
    wide = next(sensor for sensor in scene.sensors() if sensor.id() == "wide")
    return path_trace(scene, -1, samples=samples, seed=0, sensor=wide)


@cache
def package_sha256() -> str:
    """Digest of the package's own code: results of other code are not taken for its own."""
    digest = hashlib.sha256()
    for file in sorted(Path(ps.__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()
