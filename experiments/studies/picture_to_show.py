"""Which picture to show during a calibration: the bound on the errors of a scene's numbers.

With the picture known, `ps.calibrate` errs by at least the root of the diagonal of the inverse
information (Cramér and Rao), the measured values counted: of all numbers of the chair and the
plate, with colours, gain over the wall and ambient light unknown. All pictures are photographed in
one room at one exposure: under ambient light of twice the mushroom's mean, with noise of a
thousandth of both. Beside the shipped pictures, random blocks of bright colours, of several sizes
and seeds: the best of them is shipped as `blocks`. An error is over the measured value's own.

`python -m experiments.studies.picture_to_show --out DIR [--seeds 8]`
"""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

import periscopy_sim as ps
from periscopy_sim.calibration.prior import UncertainParameters, free_parameters, start_values
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph
from periscopy_sim.shipped import scenes_folder
from periscopy_sim.storage.outputs import staged_file

HIDDEN = 29, 36
SCENES = "chair", "plate"
COUNTS = (3, 4), (5, 6), (7, 9), (10, 12), (14, 18)
COLOURS = np.array([[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1]])
NONE = UncertainParameters((), np.zeros(0), np.zeros(0))


def blocks(count: tuple[int, int], seed: int) -> Array:
    """Return random blocks, (29, 36, 3), none of them black, of the colour of no neighbour."""
    random, colours = np.random.default_rng(seed), np.zeros(count, int)
    for place in np.ndindex(*count):
        beside = [colours[place[0] - 1, place[1]]] * (place[0] > 0)
        beside += [colours[place[0], place[1] - 1]] * (place[1] > 0)
        colours[place] = random.choice([k for k in range(len(COLOURS)) if k not in beside])
    rows, columns = (np.arange(n) * k // n for n, k in zip(HIDDEN, count, strict=True))
    return COLOURS[colours[np.ix_(rows, columns)]].astype(np.float64)


class Laboratory:
    """A scene in whose room pictures are photographed."""

    def __init__(self, name: str) -> None:
        self.scenario = ps.load_scenario(name, HIDDEN)
        errors = free_parameters(self.scenario.document)
        self.names, self.errors = tuple(errors), np.array(list(errors.values()))
        self.centers = start_values(self.scenario.document, self.names)
        self.A = ps.analytic_transport(self.scenario).astype(np.float64)
        mushroom = ps.read_hidden_image(ps.find_image("mushroom"), HIDDEN)
        self.ambient = 2 * float(np.mean(self.A @ mushroom.reshape(-1, 3)))

    def bounds(self, picture: Array) -> Array:
        """Return the least standard error of each number over that of its measured value."""
        shape = self.scenario.photograph_shape
        light = (self.A @ picture.reshape(-1, 3)).reshape(*shape, 3) + self.ambient
        noise = np.random.default_rng(0).normal(0, 1.5e-3 * self.ambient, light.shape)
        photographs = [Photograph.of(light + noise, shape)]
        problem = CalibrationProblem(
            self.scenario, self.names, self.centers, self.errors, NONE, photographs, [picture]
        )
        level = problem.joint()
        look = level.look(level.candidate(level.center))
        variances = np.diag(np.linalg.inv(look.curvature()))[: len(self.names)]
        return np.asarray(np.sqrt(variances) / self.errors)


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    seeds: Annotated[int, typer.Option(min=1, help="Of each number of blocks.")] = 8,
) -> None:
    """Compare pictures by the geometric mean of their bounds, and write the table."""
    shipped = sorted(path.stem for path in (scenes_folder() / "images").glob("*.png"))
    pictures = {name: ps.read_hidden_image(ps.find_image(name), HIDDEN) for name in shipped}
    pictures["white"] = np.ones((*HIDDEN, 3))
    for count in COUNTS:
        for seed in range(seeds):
            pictures["{} x {} blocks, seed {}".format(*count, seed)] = blocks(count, seed)
    rows = dict[str, dict[str, float]]()
    with threadpool_limits(1):
        laboratories = {name: Laboratory(name) for name in SCENES}
        for name, picture in pictures.items():
            rows[name] = {
                scene: float(np.exp(np.mean(np.log(laboratory.bounds(np.asarray(picture))))))
                for scene, laboratory in laboratories.items()
            }
            means = "  ".join(f"{scene} {mean:.3f}" for scene, mean in rows[name].items())
            print(f"{name:24} {means}", flush=True)
    with staged_file(out / "bounds.json") as file:
        file.write_text(json.dumps(rows, indent=2), "utf-8")
    best = min(rows, key=lambda name: float(np.prod([*rows[name].values()])))
    print(f"best: {best}; wrote {out / 'bounds.json'}")


if __name__ == "__main__":
    typer.run(main)
