"""Materials that tests of walls and of surroundings share, and the files that they read."""

from pathlib import Path

import numpy as np


def bitmap(name: str, file: str) -> str:
    return (
        f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>'
        '<boolean name="raw" value="true"/></texture>'
    )


BLEND = (
    '<bsdf type="blendbsdf"><float name="weight" value="0.6"/><bsdf type="diffuse"><rgb '
    'name="reflectance" value="0.2"/></bsdf><bsdf type="roughplastic"><rgb '
    'name="diffuse_reflectance" value="0.7"/><float name="alpha" value="0.3"/></bsdf></bsdf>'
)
BUMPS = (
    f'<bsdf type="bumpmap">{bitmap("arbitrary", "bumps.exr")}'
    '<float name="scale" value="0.1"/><bsdf type="diffuse"/></bsdf>'
)
RAMP = BUMPS.replace("bumps.exr", "ramp.exr").replace("0.1", "0.8")
SLOPE = (
    '<bsdf type="normalmap"><boolean name="use_shadowing_function" value="false"/>'
    f'{bitmap("normalmap", "slope.exr")}<bsdf type="diffuse"/></bsdf>'
)
MEASURED = '<bsdf type="measured"><string name="filename" value="paint.bsdf"/></bsdf>'


def write_files(folder: Path) -> None:
    """Write what all of them read."""
    write_heights(folder)
    write_slope(folder)
    write_paint(folder)


def write_heights(folder: Path) -> None:
    """Write the heights of `BUMPS`, at random, and of `RAMP`, which rise evenly."""
    import mitsuba as mi

    bumps = np.random.default_rng(0).random((16, 16, 1)).astype(np.float32)
    ramp = np.array([[0, 0.5], [0.5, 1]], np.float32)[..., None]
    for name, heights in (("bumps", bumps), ("ramp", ramp)):
        mi.Bitmap(heights).write(str(folder / f"{name}.exr"))


def write_slope(folder: Path, normal: tuple[float, float, float] = (0, 0.3, 0.954)) -> None:
    """Write the normals of `SLOPE`, all alike."""
    import mitsuba as mi

    slope = np.tile(np.float32(normal) / 2 + 0.5, (2, 2, 1)).astype(np.float32)
    mi.Bitmap(slope).write(str(folder / "slope.exr"))


def write_paint(folder: Path, gloss: float = 0.4) -> None:
    """Write `MEASURED`: a grey diffuse paint with a broad gloss, as a tensor file of Mitsuba's.

    Its table holds reflection times cosine, by the angle of incidence and by the half vector (θ as
    the square of a coordinate); the densities by which Mitsuba samples are constant.
    """
    from mitsuba import tensor_io

    theta_i = np.linspace(0, np.pi / 2, 8)
    u = np.linspace(0, 1, 32)
    phi, theta = np.meshgrid((2 * u - 1) * np.pi, u**2 * np.pi / 2, indexing="ij")
    across, up = np.sin(theta_i)[:, None, None], np.cos(theta_i)[:, None, None]
    along = across * np.sin(theta) * np.cos(phi) + up * np.cos(theta)
    cosine = np.maximum(0, 2 * along * np.cos(theta) - up)
    table = cosine * (0.1 + gloss * np.exp(-((theta / 0.4) ** 2)))
    ones = np.ones((1, *table.shape), np.float32)
    tensor_io.write(
        str(folder / "paint.bsdf"),
        description="paint",
        theta_i=theta_i.astype(np.float32),
        phi_i=np.zeros(1, np.float32),
        ndf=ones[0, 0],
        sigma=ones[0, 0],
        vndf=ones,
        luminance=ones,
        rgb=np.stack([table] * 3, axis=1).astype(np.float32)[None],
        jacobian=np.zeros(1, np.uint8),
    )
