"""Make the scene of a measured laboratory: its XML file and the meshes beside it."""

from contextlib import ExitStack
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.laboratory.document import load_laboratory
from periscopy_sim.rendering.load import load_geometry, load_scene
from periscopy_sim.rendering.scene_files import write_ply
from periscopy_sim.storage.outputs import spare_inputs, staged_file


def lab(measurements: str | Path, out: str | Path) -> tuple[Path, ...]:
    """Write the scene of a measured laboratory, and beside it a PLY file for each of its meshes.

    Parameters
    ----------
    measurements
        A YAML file, see `document.load_laboratory`.
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
