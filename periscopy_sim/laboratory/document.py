"""The measurements of a laboratory, a YAML file, and the scene that they make."""

from contextlib import ExitStack
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import Self

from pydantic import model_validator

from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.laboratory.bodies import AnyBody
from periscopy_sim.laboratory.entries import Errors
from periscopy_sim.laboratory.room import AnyCamera, AnyWall, HiddenSurface, Screen
from periscopy_sim.laboratory.scene_text import SceneText
from periscopy_sim.rendering.load import load_geometry, load_scene
from periscopy_sim.rendering.scene_files import write_ply
from periscopy_sim.scene import HIDDEN, MONITOR
from periscopy_sim.storage.outputs import spare_inputs, staged_file
from periscopy_sim.storage.yaml_document import Strict, read_yaml

EXAMPLE = Path(__file__).with_name("example.yaml")


class Laboratory(Strict):
    """A laboratory as measured; ``example.yaml`` beside this file explains each entry.

    `folder`, where relative paths start, is set by `load_laboratory`.
    """

    errors: Errors = Errors()
    wall: AnyWall
    camera: AnyCamera
    monitor: Screen | None = None
    hidden: tuple[HiddenSurface, ...] = ()
    occluders: tuple[AnyBody, ...] = ()
    folder: Path = Path()

    @model_validator(mode="after")
    def _names_are_known_and_differ(self) -> Self:
        bearers, names, mistakes = {""}, set[str](), list[str]()
        if not (self.monitor or self.hidden):
            mistakes.append(f"no surface is hidden; give a {MONITOR}, or a list {HIDDEN}")
        surfaces = [each.name for each in self.hidden]
        if len(set(surfaces)) < len(surfaces):
            mistakes.append(f"two hidden surfaces have one name: {', '.join(surfaces)}; rename one")
        for each in self.occluders:
            if twice := each.ids & names:
                mistakes.append(f"two occluders or bars are called '{min(twice)}'; rename one")
            if each.bearer not in bearers:
                mistakes.append(
                    f"occluder '{each.name}' stands with '{each.bearer}', but no occluder above it "
                    "with axes of its own (a rod has none) is called so"
                )
            names |= each.ids
            bearers |= {each.name} if each.has_axes else set()
        if mistakes:
            raise ValueError("; ".join(mistakes))
        return self

    def scene(self, stem: str) -> SceneText:
        """Return the scene, whose file is called `stem`.

        A ConfigurationError says that the camera sees past the wall, or a mesh cannot be read.
        """
        scene = SceneText(self.errors, stem, self.folder)
        self.wall.add_to(scene, self.camera.corners_seen(self.wall))
        self.camera.add_to(scene, self.wall)
        if self.monitor is not None:
            self.monitor.add_to(scene, MONITOR)
        for surface in self.hidden:
            surface.add_to(scene, f"{HIDDEN}_{surface.name}")
        to_world: dict[str, list[str]] = {"": []}  # from each occluder's own coordinates
        for body in self.occluders:
            to_world[body.name] = body.add_to(scene, to_world[body.bearer])
        return scene


def load_laboratory(path: str | Path) -> Laboratory:
    """Read the measurements of a laboratory from a YAML file like `EXAMPLE`.

    A ConfigurationError names the line where a number is missing, has no unit or is out of range.
    """
    return read_yaml(Path(path), Laboratory)


def lab(measurements: str | Path, out: str | Path) -> tuple[Path, ...]:
    """Write the scene of a measured laboratory, and beside it a PLY file for each of its meshes.

    Parameters
    ----------
    measurements
        A YAML file, see `load_laboratory`.
    out
        The scene's XML file. Meshes are called after it: ``lab_lamp.ply`` beside ``lab.xml``.

    Returns
    -------
    tuple of Path
        The scene and its meshes.

    Raises
    ------
    ConfigurationError
        If the measurements are no YAML, a number is missing, has no unit or no error, or is out of
        range, or a mesh cannot be read.
    SceneError
        If no photograph can be taken there: the camera sees past the wall, the monitor faces away,
        something stands before the wall.
    """
    measurements, out = Path(measurements), Path(out)
    laboratory = load_laboratory(measurements)
    try:
        scene = laboratory.scene(out.stem)
        text = scene.text(
            f"A laboratory as measured, made by periscopy lab from {measurements.name}."
        )
    except ConfigurationError as error:
        raise ConfigurationError(f"{measurements}: {error}") from None
    files = {out.with_name(name): mesh for name, mesh in scene.meshes.items()}
    spare_inputs((out, *files), [measurements, *scene.inputs])
    with TemporaryDirectory() as folder:  # the scene is tried before it is written
        trial = Path(folder) / out.name
        trial.write_text(text, encoding="utf-8")
        for file, mesh in files.items():
            write_ply(trial.with_name(file.name), mesh)
        rows, columns = (min(pixels, 64) for pixels in laboratory.camera.film)
        try:
            world = load_scene(trial)
            load_geometry(world, dict.fromkeys(world.emission, (1, 1)), photograph=(rows, columns))
        except SceneError as error:
            raise SceneError(str(error).replace(folder, str(out.parent))) from None
        with ExitStack() as stack:  # the scene is in its place last
            for file in (out, *files):
                copy = stack.enter_context(staged_file(file))
                copyfile(trial.with_name(file.name), copy)
    return out, *files


build_laboratory = lab  # its former name
