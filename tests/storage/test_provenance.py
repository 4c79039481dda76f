import json
import platform
import shutil

import mitsuba
import numpy as np
import pytest

from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.storage.provenance import provenance, scene_sha256

SCENE = """<scene version="3.0.0">
  <path value="library"/>
  <default name="texture" value="hidden"/>
  <include filename="parts/room.xml"/>
  <shape type="ply"><string name="filename" value="meshes/chair.ply"/></shape>
  <shape type="serialized" id="sofa"><string name="filename" value="sofa.serialized"/></shape>
  <alias id="sofa" as="couch"/>
  <texture type="bitmap"><string name="filename" value="$texture.png"/></texture>
  <bsdf type="diffuse"><spectrum name="reflectance" filename="paint.spd"/></bsdf>
  <volume type="gridvolume"><string name="filename" value="fog.vol"/></volume>
  <string name="note" value="notes.txt"/>
  <shape type="ply"><string name="filename" value="missing.ply"/></shape>
</scene>"""
ROOM = """<scene version="3.0.0">
  <default name="part" value="nook"/>
  <shape type="obj"><string name="filename" value="parts/wall.obj"/></shape>
  <shape type="ply"><string name="filename" value="meshes/table.ply"/></shape>
  <shape type="ply"><string name="filename" value="meshes/chair.ply"/></shape>
  <include filename="$part.xml"/>
</scene>"""
NOOK = '<emitter version="3.0.0" type="envmap"><string name="filename" value="sky.exr"/></emitter>'
REFERRED = [
    "parts/room.xml",
    "parts/wall.obj",
    "meshes/table.ply",
    "meshes/chair.ply",
    "parts/nook.xml",
    "sky.exr",
    "library/sofa.serialized",
    "hidden.png",
    "library/paint.spd",
    "library/fog.vol",
]
OTHERS = ["notes.txt", "parts/wall.mtl", "fog.vol", "parts/sky.exr", "$texture.png"]
"""Mitsuba reads no materials of an OBJ file; the others have a name that lies elsewhere."""


def sha256_of(scene, given=None):
    return scene_sha256(read_document(scene, given))


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "scenes"
    files = dict.fromkeys([*REFERRED, *OTHERS], "contents")
    files |= {"chair.xml": SCENE, "parts/room.xml": ROOM, "parts/nook.xml": NOOK}
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return folder / "chair.xml"


def test_record_is_complete_and_ready_for_json(scene):
    chosen = read_document(scene, {"texture": "other"})
    record = provenance(chosen, 7, ["periscopy", "demo", "--out", "a folder"])
    assert json.loads(json.dumps(record)) == record
    assert record["numpy"] == np.__version__ and record["mitsuba"] == mitsuba.__version__
    assert record["python"] == platform.python_version()
    assert set(record) >= {"periscopy-sim", "scipy", "drjit"}
    assert record["scene"] == str(scene) and record["parameters"] == {"texture": "other"}
    assert record["scene_sha256"] == sha256_of(scene, {"texture": "other"})
    assert (record["variant"], record["seed"]) == (mitsuba.variant(), 7)
    assert record["command"] == "periscopy demo"


def test_where_a_result_lies_is_no_part_of_its_record():
    command = ["periscopy", "reconstruct", "my photo.exr", "--scene", "chair"]
    for out in ([], ["--out", "a folder"], ["--out=elsewhere"]):
        record = provenance(None, command=[*command[:3], *out, *command[3:], "--outer", "y"])
        assert record["command"] == "periscopy reconstruct 'my photo.exr' --scene chair --outer y"


def test_digest_changes_with_every_file_of_the_scene(scene):
    for name in ["chair.xml", *REFERRED]:
        before = sha256_of(scene)
        path = scene.parent / name
        path.write_text(path.read_text() + "\n")
        assert sha256_of(scene) != before


def test_digest_does_not_change_with_other_files_or_the_place(scene, tmp_path):
    before = sha256_of(scene)
    for name in OTHERS:
        (scene.parent / name).write_text("changed")
    copy = shutil.copytree(scene.parent, tmp_path / "copy")
    assert sha256_of(copy / "chair.xml") == before


def test_files_named_by_a_parameter_are_those_digested(scene):
    other = scene.with_name("other.png")
    other.write_text("other contents")
    chosen = {"texture": "other"}
    digest = sha256_of(scene, chosen)
    assert digest != sha256_of(scene)
    other.write_text("changed contents")
    assert sha256_of(scene, chosen) != digest
