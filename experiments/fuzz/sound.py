"""Sound files of every kind that the package reads, small, for `experiments.fuzz` to damage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

SHAPE = (6, 5)
"""Rows and columns of the photographs."""

HIDDEN = (2, 3)
"""Rows and columns of the hidden images."""

LIGHT = (np.random.default_rng(8).integers(1, 9, (*SHAPE, 3)) / 8).astype(np.float32)
COUNTS = (LIGHT * 65535).astype(np.uint16)
CODES = (LIGHT * 255).astype(np.uint8)
CLIP = np.stack([LIGHT, LIGHT[::-1], LIGHT[:, ::-1]])


@dataclass(frozen=True)
class Case:
    """What a reader is given.

    Attributes
    ----------
    reader
        Name of the reader.
    kind
        What the files are, for the tally.
    files
        Contents by relative path.
    target
        The path that the reader is given; empty for the first of the files.
    """

    reader: str
    kind: str
    files: dict[str, bytes]
    target: str = field(default="")

    def write(self, folder: Path) -> Path:
        """Write the files below a folder, and give the reader's path."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return folder / (self.target or next(iter(self.files)))


def sound_cases() -> list[Case]:
    """Make a sound case of every reader and format."""
    with TemporaryDirectory() as folder:
        return [
            *_pictures(Path(folder)),
            *_sequences(Path(folder)),
            *_scenes(),
            *_configurations(),
        ]


def _written(path: Path, write: Callable[[Path], Any]) -> bytes:
    write(path)
    return path.read_bytes()


def _pictures(folder: Path) -> Iterator[Case]:
    formats = {**_exr(), **_numpy(), **_rasters()}
    for kind, write in formats.items():
        suffix = kind.rpartition(" ")[2]
        content = _written(folder / f"{kind}.{suffix}", write)
        for reader in ("photograph", "hidden image"):
            yield Case(reader, kind, {f"y.{suffix}": content})
    for kind, write in _masks().items():
        suffix = kind.rpartition(" ")[2]
        content = _written(folder / f"mask {kind}.{suffix}", write)
        yield Case("mask", kind, {f"mask.{suffix}": content})
    png = _written(folder / "still.png", formats["8-bit png"])
    yield Case("hidden frames", "8-bit png", {"f.png": png})


def _exr() -> dict[str, Callable[[Path], Any]]:
    import OpenEXR

    def save(pixels: Any, **header: Any) -> Callable[[Path], Any]:
        def write(path: Path) -> None:
            with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, {"RGB": pixels}) as file:
                file.write(str(path))

        return write

    compressions = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
    found = {
        f"{name} exr": save(LIGHT.copy(), compression=getattr(OpenEXR, f"{name}_COMPRESSION"))
        for name in compressions
    }
    found["half exr"] = save(LIGHT.astype(np.float16), compression=OpenEXR.PIZ_COMPRESSION)
    tiles = OpenEXR.TileDescription()
    found["tiled exr"] = save(LIGHT.copy(), type=OpenEXR.tiledimage, tiles=tiles)
    return found


def _numpy() -> dict[str, Callable[[Path], Any]]:
    arrays = {"photograph": LIGHT, "hidden": CODES}
    return {
        "npy": lambda path: np.save(path, LIGHT),
        "big-endian Fortran npy": lambda path: np.save(path, np.asfortranarray(LIGHT, ">f8")),
        "npz": lambda path: np.savez(path, **arrays),
        "compressed npz": lambda path: np.savez_compressed(path, **arrays),
    }


def _rasters() -> dict[str, Callable[[Path], Any]]:
    import png
    import tifffile
    from PIL import Image

    def save_16_bit(path: Path, interlaced: bool) -> None:
        with path.open("wb") as stream:
            writer = png.Writer(
                SHAPE[1], SHAPE[0], greyscale=False, bitdepth=16, interlace=interlaced
            )
            writer.write(stream, COUNTS.reshape(SHAPE[0], -1).tolist())

    def pillow(mode: str, **options: Any) -> Callable[[Path], Any]:
        return lambda path: Image.fromarray(CODES).convert(mode).save(path, **options)

    def tiff(values: Any, **options: Any) -> Callable[[Path], Any]:
        return lambda path: tifffile.imwrite(path, values, photometric="rgb", **options)

    planes = np.moveaxis(COUNTS, 2, 0).copy()
    return {
        "16-bit png": lambda path: save_16_bit(path, False),
        "interlaced 16-bit png": lambda path: save_16_bit(path, True),
        "8-bit png": pillow("RGB"),
        "transparent png": pillow("RGBA"),
        "palette png": pillow("P"),
        "1-bit png": pillow("1"),
        "jpg": pillow("RGB"),
        "progressive jpg": pillow("RGB", progressive=True, optimize=True),
        "grey jpg": pillow("L"),
        "16-bit tif": tiff(COUNTS),
        "big-endian tif": tiff(COUNTS, byteorder=">"),
        "big tif": tiff(COUNTS, bigtiff=True),
        "deflated tif": tiff(COUNTS, compression="zlib", predictor=True),
        "tiled float tif": tiff(LIGHT, tile=(16, 16)),
        "planar tif": tiff(planes, planarconfig="separate"),
        "8-bit lzw tif": pillow("RGB", compression="tiff_lzw"),
        "8-bit jpeg tif": pillow("RGB", compression="jpeg"),
    }


def _masks() -> dict[str, Callable[[Path], Any]]:
    from PIL import Image

    mask = LIGHT[..., 0] > 0.3
    return {
        "npy": lambda path: np.save(path, mask),
        "npz": lambda path: np.savez(path, mask=mask),
        "grey png": lambda path: Image.fromarray(mask.astype(np.uint8) * 255).save(path),
        "1-bit png": lambda path: Image.fromarray(mask).save(path),
    }


def _sequences(folder: Path) -> Iterator[Case]:
    import OpenEXR

    parts = [
        OpenEXR.Part({"name": f"part{k}", "type": OpenEXR.scanlineimage}, {"RGB": frame.copy()})
        for k, frame in enumerate(CLIP)
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(folder / "clip.exr"))
    yield Case("frames", "multi-part exr", {"y.exr": (folder / "clip.exr").read_bytes()})
    stack = _written(folder / "clip.npy", lambda path: np.save(path, CLIP))
    yield Case("frames", "npy stack", {"y.npy": stack})
    yield Case("hidden frames", "npy stack", {"f.npy": stack})
    for kind, save in (("npz stack", np.savez), ("compressed npz stack", np.savez_compressed)):
        content = _written(
            folder / f"{kind}.npz", lambda path, save=save: save(path, photograph=CLIP)
        )
        yield Case("frames", kind, {"y.npz": content})
    still = (folder / "8-bit png.png").read_bytes()
    pictures = {f"clip/{k}.png": still for k in range(3)}
    yield Case("frames", "folder of png", pictures, "clip")
    yield Case("hidden frames", "folder of png", pictures, "clip")
    yield from _zarr_archives(folder)


def _zarr_archives(folder: Path) -> Iterator[Case]:
    import zarr
    from zarr import codecs

    chunks = (2, *SHAPE, 3)
    forms: dict[str, dict[str, Any]] = {
        "zstd": {"chunks": chunks},
        "gzip": {"chunks": chunks, "compressors": codecs.GzipCodec()},
        "blosc": {"chunks": chunks, "compressors": codecs.BloscCodec()},
        "sharded": {"chunks": (1, *SHAPE, 3), "shards": chunks},
    }
    for kind, settings in forms.items():
        path = folder / f"{kind}.zarr"
        group = zarr.open_group(path, mode="w", zarr_format=3)
        array = group.create_array("photograph", shape=CLIP.shape, dtype=CLIP.dtype, **settings)
        array[:] = CLIP
        files = {
            f"y.zarr/{file.relative_to(path)}": file.read_bytes()
            for file in sorted(path.rglob("*"))
            if file.is_file()
        }
        yield Case("frames", f"{kind} zarr", files, "y.zarr")


ROOM = """<scene version="3.0.0">
<default name="size" value="5"/><default name="file" value="box"/>
<sensor type="orthographic" id="camera"><transform name="to_world"><scale x="0.2" y="0.2"/>
<lookat origin="0.7, 0.9, 0.3" target="0.7, 1, 0.3" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="height" value="$size"/><integer name="width" value="6"/></film>
</sensor>
<shape type="rectangle" id="wall"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
<transform name="to_world"><rotate x="1" angle="90"/><translate x="0.7" y="1" z="0.3"/></transform>
</shape>
<shape type="{monitor}" id="monitor">{screen}
<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
<shape type="{occluder}" id="box"><string name="filename" value="$file.{occluder}"/>
<boolean name="face_normals" value="true"/></shape>
</scene>
"""
_RECTANGLE = """<transform name="to_world"><scale x="0.2" y="0.15"/><rotate x="1" angle="90"/>
<rotate z="1" angle="180"/><translate x="0.2" y="0" z="0.3"/></transform>"""
_SCREEN = '<string name="filename" value="screen.ply"/>'
_VERTICES = [
    (0.4 + 0.1 * (k & 1), 0.5 + 0.1 * (k >> 1 & 1), 0.3 + 0.1 * (k >> 2)) for k in range(8)
]
_FACES = [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3),
          (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5)]  # fmt: skip
_CORNERS = ("0.4 0 0.15 0 0", "0 0 0.15 1 0", "0 0 0.45 1 1", "0.4 0 0.45 0 1")


def _ply(form: str, vertices: int, faces: int, properties: str, body: bytes) -> bytes:
    """Put a PLY file's header before its body."""
    head = (
        f"ply\nformat {form} 1.0\nelement vertex {vertices}\n{properties}element face {faces}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    return head.encode() + body


XYZ = "property float x\nproperty float y\nproperty float z\n"
UV = "property float u\nproperty float v\n"


def _scenes() -> list[Case]:
    """Make two rooms with an occluder: binary PLY, and OBJ beside a monitor of ASCII PLY."""
    faces = np.zeros(len(_FACES), dtype=[("n", "u1"), ("i", "<i4", 3)])
    faces["n"], faces["i"] = 3, _FACES
    body = np.array(_VERTICES, "<f4").tobytes() + faces.tobytes()
    binary = _ply("binary_little_endian", 8, 12, XYZ, body)
    text = "\n".join((*_CORNERS, "3 0 1 2", "3 0 2 3", ""))
    screen = _ply("ascii", 4, 2, XYZ + UV, text.encode())
    lines = [f"v {x} {y} {z}" for x, y, z in _VERTICES]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in _FACES]
    obj = ("\n".join(lines) + "\n").encode()
    plain = ROOM.format(monitor="rectangle", screen=_RECTANGLE, occluder="ply")
    meshed = ROOM.format(monitor="ply", screen=_SCREEN, occluder="obj")
    files = {"room.xml": meshed.encode(), "screen.ply": screen, "box.obj": obj}
    return [
        Case("scene", "binary ply", {"room.xml": plain.encode(), "box.ply": binary}),
        Case("scene", "ascii ply and obj", files),
    ]


def _configurations() -> Iterator[Case]:
    from periscopy_sim.dataset.configuration import EXAMPLE

    least = (
        b"count: 10\nhidden: 3x4\nscenes: [{scene: chair}]\nhidden_images: [{kind: shapes}]\n"
        b"ambient: [{kind: none}]\n"
    )
    yield Case("configuration", "least yaml", {"c.yaml": least})
    yield Case("configuration", "example yaml", {"c.yaml": EXAMPLE.read_bytes()})
