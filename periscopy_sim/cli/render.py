"""`periscopy photograph`, `periscopy ambient` and `periscopy transport`: what a scene renders."""

from typing import Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options, output
from periscopy_sim.cli.options import LIGHT, MonitorLight, argument, most_bounces, option
from periscopy_sim.cli.session import ALL_BUT_SHADOWS, Session
from periscopy_sim.measurement import TARGET
from periscopy_sim.shipped import CONDITIONS, DARK, find_condition
from periscopy_sim.storage import provenance, rasters

TargetOption = Annotated[float, option("NUMBER", kind="error")]
_IMAGE = "The hidden image: a file, or a shipped one."
_OF_EACH = "Image of a hidden surface; repeatable."
_SAMPLES = "Camera samples a pixel of the path tracer. [default: as the SNR needs, without it]"
_NAMES = "Scene files or shipped conditions."
_AMBIENT = "Ambient light to add: a photograph by the same camera, a condition, or none."


def photograph(
    *,
    session: Annotated[Session, {"hidden": ["29x36"]}],
    image: Annotated[str | None, argument("IMAGE", _IMAGE)] = None,
    images: Annotated[list[str] | None, option("ID=IMAGE", _OF_EACH, "--image")] = None,
    out: options.OutFile,
    samples: Annotated[
        int | None, option("NUMBER", _SAMPLES, kind="camera samples", group=LIGHT)
    ] = None,
    bounces: options.BouncesOption = "all",
    ambient: Annotated[str | None, option("LIGHT", _AMBIENT, group=LIGHT)] = None,
    sbr: Annotated[float | None, option("RATIO", kind="ratio", group=LIGHT)] = None,
    colour_matrix: options.ColourMatrixOption = None,
    snr: options.OptionalSnr = None,
    target: TargetOption = TARGET,
) -> None:
    """Render a photograph of the wall, as an EXR file.

    Its own error is at most a third of the noise of --snr (else of 60 dB); a line says if not.
    """
    options.require_suffix(out, ".exr", "the photograph")
    is_lit = ambient not in (None, DARK)
    if is_lit != (sbr is not None):
        raise ps.PeriscopyError("--sbr and light of --ambient go together; give both or neither")
    colours = None if colour_matrix is None else ps.read_colour_matrix(colour_matrix)
    most = most_bounces(bounces)
    if colours is not None and len(colours.matrix) != 3:
        raise ps.PeriscopyError(f"{colour_matrix}: give three rows: photographs as EXR have three")
    names = session.by_surface([*filter(None, [image]), *(images or ())], "--image")
    hidden = session.scenario.hidden
    settings: dict[str, Any] = {
        "camera": session.sensor,
        "image": hidden.unwrapped(names), "hidden": hidden.sizes, "samples": samples,
        "bounces": bounces, "ambient": ambient,
        "sbr": sbr, "snr": snr, "target": target if is_lit else None,
        "colour_matrix": None if colours is None else colours.matrix.tolist(),
    }  # fmt: skip
    with output.output_files(out) as (file,):
        session.check_scene(but=ALL_BUT_SHADOWS)
        picture = session.scenario.image(names)
        if is_lit and ambient is not None:
            session.ambient_light(ambient, target)
        with output.progress("rendering the photograph") as report:
            y = session.scenario.photograph(
                picture, ambient=ambient, sbr=sbr, snr=snr, bounces=most, samples=samples,
                target=target, colour_matrix=colours, progress=report,
            )  # fmt: skip
        settings["relative_error"] = float(f"{y.relative_error:.3g}")
        session.warn(*y.warnings)
        settings["image_sha256"] = provenance.image_sha256(picture)
        rasters.write_exr(file, y.values, provenance.as_text({**settings, **session.provenance}))
    output.record(**settings)


def ambient(
    scene: options.SceneOption,
    out: options.Out,
    names: Annotated[list[str] | None, argument("NAME", _NAMES)] = None,
    target: TargetOption = TARGET,
    seed: options.Seed = 0,
    define: options.Define = None,
) -> None:
    """Photograph the wall of a scene under ambient light.

    The command path traces each condition and writes NAME.exr.
    """
    chosen = names or CONDITIONS
    paths = {find_condition(name).stem: find_condition(name) for name in chosen}
    if len(paths) < len(chosen):
        raise ps.PeriscopyError(f"an ambient condition is given twice in {', '.join(chosen)}")
    session, errors = Session(scene, [], define, seed), dict[str, float]()
    with output.output_folder(out) as folder:
        for name, path in paths.items():
            light = session.ambient_light(path, target)
            parts = {each: getattr(light, each) for each in ("relative_error", "brightness_error")}
            made = {
                "ambient": name,
                "ambient_sha256": provenance.scene_sha256(path),
                "target": f"{target:g}",
            }
            metadata = provenance.as_text({**session.provenance, **made})
            rasters.write_exr(folder / f"{name}.exr", light.photograph, {**metadata, **parts})
            errors[name] = float(np.hypot(*parts.values()))
    rows = [[name, f"{error:.1e}"] for name, error in errors.items()]
    output.show_table(rows, ["light", "relative error of a pixel"])
    output.record(relative_error=errors)


def transport(session: Session, light: MonitorLight, out: options.OutFile) -> None:
    """Render the light transport matrix A of a scene.

    The command writes an (M, N) float32 NPY file and a JSON file. Where light bounces, the NPY
    file holds the mean of the channels' matrices, and an NPZ file their differences from it.
    """
    options.require_suffix(out, ".npy", "the matrix")
    from periscopy_sim.storage.transport_matrix import transport_writer

    session.check_scene()
    with transport_writer(out, light.most_bounces) as write:
        scenario = session.lit(light)
        session.transport(scenario)
        A, plan = scenario.transport(), scenario.plan()
        origin = {
            "photograph_shape": session.scenario.photograph_shape,
            "hidden_shape": session.hidden_shape,
            **plan.origin,
            **session.provenance,
        }
        beside = write(A, origin)
    way = "areas" if plan.samples is None else f"{plan.samples} rays"
    rows = ["A", f"{A.shape[0]}x{A.shape[1]}"], ["by", way]
    output.show_table([*rows, ["error of the light", f"{100 * plan.error:.2g} %"]])
    output.record(**origin)
    output.written(out, *beside)
