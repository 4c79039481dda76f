"""The paper's experiment: the chair scene, its matrices, photographs and ambient light.

What takes long to render is kept in the folder of the run and read again by the next figure.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.cli.ambient import ambient_photographs
from periscopy_sim.figures.report import Section
from periscopy_sim.rendering.photograph import render_place
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.formats.exr import read_exr, write_exr
from periscopy_sim.storage.outputs.provenance import scene_sha256
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]
SNR = 60.0
"""dB (Sec. 4.1)."""

GLASS = "stained_glass"
GLASS_SCENE = f"ambient/{GLASS}"
NO_BEAM = f"{GLASS}_no_beam"
"""The stained glass seen from the wall, without the sun through it that falls on the wall."""

WITHOUT_BEAM = {"sunbeam": "0"}


@dataclass(frozen=True, eq=False)
class Measured:
    """A photograph without ambient light and what the monitor showed.

    Attributes
    ----------
    signal
        (rows, columns, 3), linear.
    truth
        (R, C, 3) in [0, 1], linear.
    real
        Whether a camera took it.
    """

    signal: Array
    truth: Array
    real: bool


class Setting:
    """The chair scene with 36 x 29 hidden patches, and what is made from it, each when first asked.

    Parameters
    ----------
    out
        Folder of the run; what was rendered is kept in its folder ``rendered``.
    real
        NPZ file with a real photograph of the scene (``photograph``) and its ``hidden`` image.
    """

    hidden = (29, 36)
    image = "mushroom"
    seed = 0

    def __init__(self, out: Path, real: Path | None = None) -> None:
        self.out = out
        self.real = real
        self.rendered = out / "rendered"

    @cached_property
    def scenario(self) -> Scenario:
        """The chair scene."""
        return ps.load_scenario(ps.find_scene("chair"), self.hidden)

    @cached_property
    def A(self) -> NDArray[np.float32]:  # noqa: N802 (the paper's name)
        """(M, N) light transport matrix."""
        return ps.render_transport(self.scenario, seed=self.seed)

    @cached_property
    def B(self) -> Array:  # noqa: N802
        """(M, 512) the paper's point lights (Sec. 3.1)."""
        return ps.point_light_backgrounds(self.scenario)

    @cached_property
    def preconditioned(self) -> ps.Periscope:
        """The paper's method, fitted."""
        return ps.Periscope.for_scene(self.scenario, self.A, self.B)

    @cached_property
    def differencing(self) -> ps.Differencing:
        """The method of [15], run to convergence, fitted."""
        return ps.Differencing(
            self.A,
            photograph_shape=self.scenario.photograph_shape,
            hidden_shape=self.hidden,
            channel_gain=self.scenario.channel_gain,
        )

    @cached_property
    def synthetic(self) -> Measured:
        """The photograph as path traced, light bouncing about the scene included."""
        truth = ps.read_hidden_image(ps.find_image(self.image), self.hidden)

        def render() -> Array:
            return ps.render_photograph(self.scenario, truth, samples=8192, seed=self.seed)

        return Measured(self.kept(self.image, "chair", render), truth, real=False)

    @cached_property
    def measured(self) -> Measured:
        """The real photograph where there is one, else the path-traced one."""
        if self.real is None:
            return self.synthetic
        signal = ps.read_photograph(self.real, self.scenario.photograph_shape).values
        return Measured(signal, ps.read_hidden_image(self.real, self.hidden), real=True)

    def backgrounds(self, names: Sequence[str] = REALISTIC) -> dict[str, Array]:
        """Photographs of the board under ambient light: the realistic conditions, or others."""
        return ambient_photographs(names, self.scenario, self.rendered, self.seed)

    def photograph(self, background: Array | None, sbr: float, name: str) -> Array:
        """Photograph at an SBR and `SNR` (Sec. 4.1); the noise follows from the name and the SBR.

        Parameters
        ----------
        background
            (rows, columns, 3) ambient light; None for none.
        sbr
            Signal-to-background ratio.
        name
            Of the background.

        Returns
        -------
        ndarray
            (rows, columns, 3) of mean 1, plus noise.
        """
        signal = self.measured.signal
        exposed = (
            signal / signal.mean() if background is None else ps.composite(signal, background, sbr)
        )
        identity = hashlib.sha256(json.dumps([self.seed, name, sbr]).encode()).digest()
        return ps.add_noise(exposed, SNR, int.from_bytes(identity[:16]))

    def kept(self, name: str, scene: str, render: Callable[[], Array]) -> Array:
        """Render a picture, or read it if the same was rendered in this folder before.

        Parameters
        ----------
        name
            Of the file.
        scene
            What is rendered.
        render
            Renders it, by this package and from this scene and the chair's alone.
        """
        file = self.rendered / f"{name}.exr"
        record = {
            "scene_sha256": scene_sha256(ps.find_scene(scene)),
            "chair_sha256": scene_sha256(ps.find_scene("chair")),
            "package_sha256": package_sha256(),
            "seed": str(self.seed),
        }
        if not (file.is_file() and record.items() <= read_exr(file)[1].items()):
            with staged_file(file) as staged:
                write_exr(staged, render(), record)
        return np.asarray(read_exr(file)[0], np.float64)

    @property
    def adversarial(self) -> dict[str, Array]:
        """The two adversarial conditions (Fig. 5), the window also without its sunbeam."""
        lit = self.backgrounds(ADVERSARIAL)
        return {
            GLASS: lit.pop(GLASS),
            NO_BEAM: self.kept(NO_BEAM, GLASS_SCENE, self._no_beam),
            **lit,
        }

    def place(self, name: str) -> Array:
        """Picture of the place of an ambient condition, to look at: (300, 400, 3)."""
        scene, parameters = (GLASS, WITHOUT_BEAM) if name == NO_BEAM else (name, {})

        def render() -> Array:
            return render_place(f"ambient/{scene}", parameters, size=(300, 400), samples=144)

        return self.kept(f"{name}_wide", f"ambient/{scene}", render)

    def _no_beam(self) -> Array:
        return ps.render_background(
            GLASS_SCENE, self.scenario, WITHOUT_BEAM, seed=self.seed
        ).photograph


Experiment = Callable[[Setting], Section]


@cache
def package_sha256() -> str:
    """Digest of the package's own code: results of other code are not taken for its own."""
    digest = hashlib.sha256()
    for file in sorted(Path(ps.__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def timed(experiment: Experiment, setting: Setting) -> Section:
    """Run an experiment and note how long it took."""
    start = time.perf_counter()
    section = experiment(setting)
    return replace(section, seconds=time.perf_counter() - start)


def alone(experiment: Experiment) -> None:
    """Run one experiment from the command line and print its claims; see `experiments.paper`."""

    def main(
        out: Annotated[Path, typer.Option(help="Folder to write.")],
        real: Annotated[Path | None, typer.Option(help="A real photograph, NPZ.")] = None,
    ) -> None:
        try:
            section = timed(experiment, Setting(out, real))
        except ps.PeriscopyError as error:
            print(f"error: {error}", file=sys.stderr)
            raise typer.Exit(2) from None
        for claim in section.claims:
            print(f"{claim.what}: {claim.measured} (paper: {claim.stated}) {claim.verdict}")
        print(f"{section.name}: {section.seconds:.1f} s")

    main.__doc__ = experiment.__doc__
    typer.run(main)
