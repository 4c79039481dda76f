"""Files that ask for more memory or time than there is: refused by their heads."""

import json
import os
import struct
import tracemalloc
import zlib

import numpy as np
import pytest

from periscopy_sim.dataset.configuration import load_configuration
from periscopy_sim.errors import ConfigurationError, PhotographError
from periscopy_sim.laboratory.document import load_laboratory
from periscopy_sim.numerics.validation import read_json
from periscopy_sim.rendering.scene_files import read_mesh
from periscopy_sim.storage import photographs
from periscopy_sim.storage.pictures import read_hidden_image
from periscopy_sim.storage.rasters import write_exr

SIZE = 8, 8


def exr(path):
    write_exr(path, np.ones((*SIZE, 3)), {})
    content = bytearray(path.read_bytes())
    for name in (b"dataWindow", b"displayWindow"):
        place = content.index(name + b"\0box2i\0") + len(name) + 11
        content[place : place + 16] = struct.pack("<4i", 0, 0, 99_999, 99_999)
    path.write_bytes(content)


def png(path):
    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(
            ">I", zlib.crc32(kind + content))  # fmt: skip

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 10**5, 10**5, 16, 2, 0, 0, 0))
    end = chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + end)


@pytest.mark.parametrize("save", [exr, png])
def test_pictures_are_refused_before_they_are_decoded(save, tmp_path):
    save(path := tmp_path / "y")
    tracemalloc.start()
    for read in (
        lambda: photographs.read_photograph(path, SIZE),
        lambda: read_hidden_image(path, (2, 2)),
        lambda: photographs.read_mask(path),
        lambda: photographs.read_sensor_image(path),
    ):
        with pytest.raises(PhotographError):
            read()
    assert tracemalloc.get_traced_memory()[1] < 1 << 25
    tracemalloc.stop()


@pytest.mark.parametrize("read", [load_configuration, load_laboratory])
def test_yaml_without_end_is_refused(read, tmp_path):
    for text in ("hidden: &a [*a]", "a: " + "[" * 999, "#" * (1 << 18)):
        (tmp_path / "a.yaml").write_text(text)
        with pytest.raises(ConfigurationError, match=r"a\.yaml"):
            read(tmp_path / "a.yaml")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigurationError, match="regular file"):
        read(tmp_path / "pipe")


def test_json_nested_without_end_is_a_value_error(tmp_path):
    (tmp_path / "a.json").write_text("[" * 200_000)
    with pytest.raises(ValueError, match="deeply"):
        read_json(tmp_path / "a.json")


def glb(accessor):
    text = json.dumps({"asset": {"version": "2.0"}, "accessors": [accessor]}).encode()
    size = len(text).to_bytes(4, "little")
    return b"glTF\2\0\0\0" + (20 + len(text)).to_bytes(4, "little") + size + b"JSON" + text


PLY = b"ply\nformat ascii 1.0\nelement vertex 1000000000\nproperty float x\nend_header\n"


@pytest.mark.parametrize(("name", "content"), [("a.ply", PLY), ("a.glb", glb({"count": 10**9}))])
def test_meshes_hold_what_they_announce(name, content, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match="announces more"):
        read_mesh(tmp_path / name)
