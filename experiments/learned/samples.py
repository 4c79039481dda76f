"""Photographs of a data set as the network sees them, each solved by the noise-aware method.

`python -m experiments.learned.samples PHOTOGRAPHS.zarr --out DIR` writes a file for each geometry
of the data set, and goes on where it was stopped. Each photograph is solved in the scene as it is,
and in one with a ruler's errors: some numbers off by Gaussian errors as the scene declares
them (`NAME_error`), times a factor that is drawn. There the image stands displaced, and nothing in
the photograph says by how much: the network is to learn the displaced one, the truth shifted to
where the noise-aware image has it.
"""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.learned.unrolled import HIDDEN, Problem, problem_of
from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.storage.provenance import resumed_folder

RIGHT = 0.75
"""Share of a geometry's photographs that are solved in the scene as it is."""

WORST = 1.0
"""Of the declared errors, at most: the factor is uniform up to this."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Photographs of one geometry as the network sees them; see `Problems`.

    Attributes
    ----------
    rows, curvatures
        Of the scene that the method was given.
    data, weights, errors, start
        (n, ...) of each photograph.
    truth
        (n, 3, R, C) hidden image, over the image's scale.
    split
        Of the geometry.
    """

    rows: NDArray[np.float32]
    curvatures: NDArray[np.float32]
    data: NDArray[np.float32]
    weights: NDArray[np.float32]
    errors: NDArray[np.float32]
    start: NDArray[np.float32]
    truth: NDArray[np.float32]
    split: str

    def write(self, file: Path) -> None:
        """Write to an uncompressed NPZ file."""
        with staged_file(file) as staged, staged.open("wb") as opened:
            np.savez(opened, **{each.name: getattr(self, each.name) for each in fields(self)})

    @classmethod
    def read(cls, file: Path) -> "Samples":
        """Read what `write` wrote."""
        with np.load(file) as held:
            return cls(**{**held, "split": str(held["split"])})


def as_displaced(truth: NDArray[Any], image: NDArray[Any]) -> NDArray[Any]:
    """Return a hidden image, (R, C, 3), shifted to where another stands; borders are continued."""
    from scipy import ndimage

    down, right = ps.registered(image, truth / truth.max()).shift
    moved: NDArray[Any] = ndimage.shift(truth, (-down, -right, 0), order=1, mode="nearest")
    return moved


def ruler_values(
    true: dict[str, float], factor: float, rng: np.random.Generator
) -> dict[str, float]:
    """Return a chair scene's numbers as a ruler gives them, off by `factor` declared errors."""
    document = read_document(ps.find_scene("chair"))
    values = {name: float(value) for name, value in document.defaults.items()} | true
    return true | {
        name: values[name] + factor * error * float(np.clip(rng.standard_normal(), -2, 2))
        for name, error in sorted(declared_errors(document).items())
    }


def solved(
    scene: ps.Scenario,
    photographs: NDArray[Any],
    hidden: NDArray[Any],
    scales: NDArray[Any],
    split: str,
    displaced: bool,
    seed: int,
) -> "Samples":
    """Return photographs as the network sees them in a scene; see the module."""
    A = ps.render_transport(scene, samples=16, seed=seed)
    # In the scene as it is, the data set's lamps leave hardly a gain or light beyond range(B) to be
    # found: of 40 images 35 are the same without looking for them, none is off by more than 0.2 %.
    method = ps.NoiseAware.for_scene(
        scene, A, ps.point_light_backgrounds(scene), corrections=None if displaced else ()
    )
    problems: list[Problem] = []
    truths = []
    for photograph, image, scale in zip(photographs, hidden, scales, strict=True):
        found = method.solve(photograph)
        problem = problem_of(method, found)
        if problem is None:
            continue
        truth = scale * image.astype(np.float64)
        if displaced:
            truth = as_displaced(truth, found.image)
        problems.append(problem)
        truths.append((np.moveaxis(truth, -1, 0) / problem.scale).astype(np.float32))
    stacks = {
        name: np.stack([getattr(each, name) for each in problems])
        for name in ("data", "weights", "errors", "start")
    }
    basis = method.fit.patterns
    return Samples(
        rows=basis.rows, curvatures=basis.curvatures.astype(np.float32), **stacks,
        truth=np.stack(truths), split=split,
    )  # fmt: skip


def main(
    photographs: Annotated[Path, typer.Argument(help="What periscopy dataset wrote.")],
    out: Annotated[Path, typer.Option(help="Folder for the samples.")],
    seed: Annotated[int, typer.Option(help="Of the ruler's errors.")] = 0,
) -> None:
    """Solve the photographs of every geometry, in the true scene and in the ruler's."""
    data = ps.open_dataset(photographs)
    settings = {"seed": seed, "photographs": json.loads(json.dumps(dict(data.attrs)))}
    with resumed_folder(out, settings, "set of samples", ["*.npz"]):
        pass
    for number in np.unique(data.geometry.values):
        own = data.isel(sample=np.flatnonzero(data.geometry.values == number))
        prefix = "parameter_"
        values = {
            str(name).removeprefix(prefix): float(data[name].values[number])
            for name in data.variables
            if str(name).startswith(prefix)
        }
        right = round(RIGHT * len(own.sample))
        for kind, chosen in {"right": slice(0, right), "ruler": slice(right, None)}.items():
            file = out / f"{number:03d}_{kind}.npz"
            if file.exists():
                continue
            if kind == "ruler":
                rng = np.random.default_rng([seed, int(number)])
                values = ruler_values(values, WORST * rng.random(), rng)
            scene = ps.load_scenario("chair", HIDDEN, values)
            taken = own.isel(sample=chosen)
            made = solved(
                scene, taken.photograph.values, taken.hidden.values, taken.signal_scale.values,
                str(taken.split.values[0]), kind == "ruler", seed=1000 + int(number),
            )  # fmt: skip
            made.write(file)
            print(f"{file.name}: {len(made.start)} photographs ({made.split})", flush=True)


if __name__ == "__main__":
    typer.run(main)
