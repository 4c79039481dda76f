"""Materials that tests of walls and of surroundings share, and the files that they read."""

from pathlib import Path

import numpy as np

from periscopy_sim.rendering.variant import mi


def bitmap(name: str, file: str) -> str:
    return (
        f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>'
        '<boolean name="raw" value="true"/></texture>'
    )


def checkered(first: str, second: str, squares: object, *, name: str = "reflectance") -> str:
    return (
        f'<texture type="checkerboard" name="{name}">'
        f'<rgb name="color0" value="{first}"/><rgb name="color1" value="{second}"/>'
        f'<transform name="to_uv"><scale value="{squares}"/></transform></texture>'
    )


def diffuse(texture: str) -> str:
    return f'<bsdf type="diffuse">{texture}</bsdf>'


def painted(color: object) -> str:
    return f'<bsdf type="diffuse"><rgb name="reflectance" value="{color}"/></bsdf>'


GLOSSY = '<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>'
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


def write_files(folder: Path) -> None:
    """Write what all of them read."""
    write_heights(folder)
    write_slope(folder)


def write_heights(folder: Path) -> None:
    """Write the heights of `BUMPS`, at random, and of `RAMP`, which rise evenly."""
    bumps = np.random.default_rng(0).random((16, 16, 1)).astype(np.float32)
    ramp = np.array([[0, 0.5], [0.5, 1]], np.float32)[..., None]
    for name, heights in (("bumps", bumps), ("ramp", ramp)):
        mi.Bitmap(heights).write(str(folder / f"{name}.exr"))


def write_slope(folder: Path, normal: tuple[float, float, float] = (0, 0.3, 0.954)) -> None:
    """Write the normals of `SLOPE`, all alike."""
    slope = np.tile(np.float32(normal) / 2 + 0.5, (2, 2, 1)).astype(np.float32)
    mi.Bitmap(slope).write(str(folder / "slope.exr"))
