"""Hostile scenes, meshes and configurations: they expand, nest or refer without end."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from experiments.fuzz.sound import UV, XYZ, Case, ply, sound_scenes

_SAY = (
    "0", "-1", "1", "nan", "inf", "-inf", "1e30", "-1e30", "1e-30", "1e400", "x", "", "1 2 3",
    "$size", "$nothing", "99999999999999999999",
)  # fmt: skip


def hostile_texts() -> Iterator[Case]:
    """Make each hostile scene and configuration once."""
    plain, meshed = sound_scenes()
    yield from _documents(plain)
    yield from _numbers(plain)
    yield from _binary_meshes(plain)
    yield from _text_meshes(meshed)
    yield from _configurations()


def _changed(case: Case, kind: str, **files: bytes) -> Case:
    named = {name.replace("_", "."): content for name, content in files.items()}
    return Case("scene", f"hostile {kind}", {**case.files, **named})


def _documents(sound: Case) -> Iterator[Case]:
    room = sound.files["room.xml"]
    entities = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))
    doctype = f'<!DOCTYPE scene [<!ENTITY l0 "ha">{entities}]>'.encode()
    expanded = room.replace(b'name="file" value="box"', b'name="file" value="&l11;"')
    yield _changed(sound, "entities", room_xml=doctype + expanded)
    long = f'<!DOCTYPE scene [<!ENTITY l "{"a" * 100_000}">]>'.encode()
    expanded = room.replace(b'value="box"', b'value="' + b"&l;" * 10_000 + b'"')
    yield _changed(sound, "entities", room_xml=long + expanded)
    outside = b'<!DOCTYPE scene [<!ENTITY l SYSTEM "file:///etc/hostname">]>'
    yield _changed(sound, "entities", room_xml=outside + room.replace(b'"box"', b'"&l;"'))
    for depth in (100, 5000, 200_000):
        for tag in (b"scene", b"shape", b'bsdf type="twosided"', b"x"):
            name = tag.split()[0]
            nested = b"<" + tag + b">"
            nested = nested * depth + b"</" + name + b">" * 1
            closing = (b"</" + name + b">") * (depth - 1)
            yield _changed(
                sound, "nesting", room_xml=room.replace(b"</scene>", nested + closing + b"</scene>")
            )
    include = b'<include filename="%s"/>'
    for names in (b"room.xml", b"/", b".", b"/dev/zero", b"nowhere.xml", b"a.xml"):
        text = room.replace(b"</scene>", include % names + b"</scene>")
        loop = b'<scene version="3.0.0">' + include % b"a.xml" + b"</scene>"
        yield _changed(sound, "includes", room_xml=text, a_xml=loop)
    for depth in (8, 40):
        chain = {
            f"i{k}.xml": b'<scene version="3.0.0">'
            + include % (b"i%d.xml" % (k + 1)) * 2
            + b"</scene>"
            for k in range(depth)
        }
        chain[f"i{depth}.xml"] = b'<scene version="3.0.0"/>'
        text = room.replace(b"</scene>", include % b"i0.xml" + b"</scene>")
        yield Case("scene", "hostile includes", {**sound.files, **chain, "room.xml": text})
    for name in (b"/dev/zero", b"/", b"", b"x" * 5000, b"\xff", b"box.ply/", b"/proc/self/mem"):
        text = room.replace(b"$file.ply", name)
        yield _changed(sound, "file names", room_xml=text)
    for encoding in ("utf-16", "utf-32", "utf-7", "x"):
        head = f'<?xml version="1.0" encoding="{encoding}"?>'.encode()
        yield _changed(sound, "encoding", room_xml=head + room)
    yield _changed(sound, "encoding", room_xml=room.decode().encode("utf-16"))
    for value in (b"$file", b"$a", b"$$", b"$", b"${x", b"$size" * 1000):
        yield _changed(
            sound, "defaults", room_xml=room.replace(b'value="box"', b'value="' + value + b'"')
        )
    many = b"".join(b'<default name="d%d" value="$d%d"/>' % (k, k + 1) for k in range(20_000))
    yield _changed(sound, "defaults", room_xml=room.replace(b"</scene>", many + b"</scene>"))
    for extra in (
        b'<ref id="wall"/>', b'<ref id="nothing"/>',
        b'<bsdf type="twosided" id="a"><ref id="a"/></bsdf>',
        b'<shape type="instance"><ref id="g"/></shape><shape type="shapegroup" id="g"/>',
        b'<shape type="sphere" id="wall"/>', b'<shape type="x"/>', b'<shape type=""/>', b"<x/>",
        b'<sensor type="perspective" id="camera"/>', b'<emitter type="envmap"/>',
        b'<shape type="sphere"><float name="radius" value="nan"/></shape>',
        b'<shape type="sphere"><float name="radius" value="0"/></shape>',
        b'<shape type="cylinder"><float name="radius" value="-1"/></shape>',
        b'<shape type="disk"/>', b'<shape type="cube"/>', b'<shape type="ply"/>',
        b'<shape type="obj"/>',
        b'<shape type="serialized"><string name="filename" value="box.ply"/></shape>',
        b'<shape type="linearcurve"><string name="filename" value="box.ply"/></shape>',
        b'<shape type="bsplinecurve"><string name="filename" value="box.ply"/></shape>',
        b'<shape type="sdfgrid"><string name="filename" value="box.ply"/></shape>',
        b'<shape type="ellipsoids"><string name="filename" value="box.ply"/></shape>',
        b'<texture type="bitmap"><string name="filename" value="box.ply"/></texture>',
        b'<emitter type="envmap"><string name="filename" value="box.ply"/></emitter>',
        b'<bsdf type="measured"><string name="filename" value="box.ply"/></bsdf>',
    ):  # fmt: skip
        yield _changed(sound, "extras", room_xml=room.replace(b"</scene>", extra + b"</scene>"))


def _numbers(sound: Case) -> Iterator[Case]:
    """Every number of the scene replaced in turn by some that mean trouble."""
    room = sound.files["room.xml"]
    for value in ("0", "-1", "1", "65536", "1000000", "2147483647", "4294967296", "1e9", "nan", ""):
        for entry in (b'name="width" value="6"', b'name="size" value="5"'):
            name = entry.split(b" value")[0]
            changed = room.replace(entry, name + b' value="' + value.encode() + b'"')
            yield _changed(sound, "film", room_xml=changed)
    crop = b'<integer name="crop_%s" value="%d"/></film>'
    for name in (b"width", b"height", b"offset_x"):
        for number in (0, -1, 1 << 31):
            changed = room.replace(b"</film>", crop % (name, number))
            yield _changed(sound, "film", room_xml=changed)
    for old in (b'x="0.2" y="0.15"', b'x="0.2" y="0.2"', b'x="0.7" y="1" z="0.3"', b'value="0.5"',
                b'up="0, 0, 1"', b'target="0.7, 1, 0.3"', b'angle="180"',
                b'name="radiance" value="1"'):  # fmt: skip
        for value in _SAY:
            head, _, rest = old.partition(b'="')
            first = head + b'="' + value.encode() + b'"' + rest.partition(b'"')[2]
            if b"value" in old and b"name" in old:
                first = old.rpartition(b'="')[0] + b'="' + value.encode() + b'"'
            yield _changed(sound, "numbers", room_xml=room.replace(old, first))


def _binary_meshes(sound: Case) -> Iterator[Case]:
    box = sound.files["box.ply"]
    body = box.partition(b"end_header\n")[2]
    form = "binary_little_endian"
    for vertices in (0, 1, 7, 9, -1, 1 << 20, 1 << 31, 1 << 32, 1 << 62):
        for faces in (0, 12, 13, -1, 1 << 28, 1 << 32):
            yield _changed(sound, "ply size", box_ply=ply(form, vertices, faces, XYZ, body))
    for index in (-1, 8, 1 << 20, 1 << 30, (1 << 31) - 1, -(1 << 31)):
        changed = body[:-4] + struct.pack("<i", index)
        yield _changed(sound, "ply index", box_ply=ply(form, 8, 12, XYZ, changed))
    for number in (np.nan, np.inf, -np.inf, 3e38, 1e-45):
        changed = struct.pack("<f", number) + body[4:]
        yield _changed(sound, "ply vertex", box_ply=ply(form, 8, 12, XYZ, changed))
        everywhere = struct.pack("<f", number) * 24 + body[96:]
        yield _changed(sound, "ply vertex", box_ply=ply(form, 8, 12, XYZ, everywhere))
    for corners in (0, 1, 2, 4, 255):
        changed = body[:96] + bytes([corners]) + body[97:]
        yield _changed(sound, "ply corners", box_ply=ply(form, 8, 12, XYZ, changed))
    for old, new in (
        (b"float x", b"list uchar float x"), (b"float x", b"double x"), (b"float x", b"blob x"),
        (b"float x", b"float y"), (b"property float z\n", b""), (b"uchar int", b"int int"),
        (b"uchar int", b"double int"), (b"uchar int", b"uchar float"), (b"uchar int", b"uint uint"),
        (b"vertex_indices", b"vertex_index"), (b"vertex_indices", b"x"), (b"vertex", b"edge"),
        (b"element face 12", b"element face 12\nelement face 12"), (b"end_header\n", b""),
        (b"little", b"big"), (b"1.0", b"9.9"), (b"format", b"comment"), (b"end_header",
                                                                         b"end_header\r"),
        (b"element face", b"comment\nelement face"), (b"ply\n", b"ply"), (b"8", b"8 8"), (b"8",
                                                                                          b"x"),
        (b"property float x", b"property float x\n" + b"property float q\n" * 1000),
        (b"ply\n", b"ply\ncomment " + b"a" * 1_000_000 + b"\n"), (b"property list", b"property"),
    ):  # fmt: skip
        yield _changed(sound, "ply header", box_ply=box.replace(old, new, 1))


def _text_meshes(sound: Case) -> Iterator[Case]:
    screen, box = sound.files["screen.ply"], sound.files["box.obj"]
    for old, new in (
        (b"0.4 0 0.15", b"nan 0 0.15"), (b"0.4 0 0.15", b"1e99 0 0.15"), (b"0.4 0 0.15",
                                                                          b"x 0 0.15"),
        (b"3 0 1 2", b"3 0 1 4"), (b"3 0 1 2", b"3 0 1 -1"), (b"3 0 1 2", b"3 0 1 99999999999"),
        (b"3 0 1 2", b"4 0 1 2 3"), (b"3 0 1 2", b"255 0"), (b"3 0 1 2", b"3 0 0 0"), (b"3 0 1 2",
                                                                                       b""),
        (b"vertex 4", b"vertex 400000000"), (b"face 2", b"face 400000000"), (b"vertex 4",
                                                                             b"vertex -4"),
    ):  # fmt: skip
        yield _changed(sound, "ascii ply", screen_ply=screen.replace(old, new, 1))
    for uv in ("nan", "inf", "1e30", "0"):
        rows = "\n".join(f"{x} 0 {z} {uv} {uv}" for x, z in ((0.4, 0), (0, 0), (0, 1), (0.4, 1)))
        text = ply("ascii", 4, 2, XYZ + UV, f"{rows}\n3 0 1 2\n3 0 2 3\n".encode())
        yield _changed(sound, "ascii ply", screen_ply=text)
    for line in (
        "f 1 2", "f 1", "f", "f 0 1 2", "f 9 1 2", "f -1 -2 -3", "f -9 1 2", "f 99999999999 1 2",
        "f 1/1/1 2/2/2 3/3/3", "f 1//9 2//9 3//9", "f 1/9 2/9 3/9", "f a b c", "f 1.5 2 3",
        "f " + "1 " * 200_000,
        "v", "v 1", "v nan nan nan", "v inf 0 0", "v 1e99 0 0", "v x y z", "vt", "vn", "vt nan nan",
        "f 1/1/1/1 2 3", "f 4294967297 2 3", "f 2147483648 2 3", "x" * 1_000_000, "\x00\xff",
        "mtllib /dev/zero",
        "f 1 2 3\\", "f 1 2 3 4 5 6 7 8",
    ):  # fmt: skip
        yield _changed(sound, "obj", box_obj=box + line.encode("latin-1") + b"\n")
        yield _changed(sound, "obj", box_obj=line.encode("latin-1") + b"\n" + box)
    yield _changed(sound, "obj", box_obj=b"v 0 0 0\n")
    yield _changed(sound, "obj", box_obj=b"f 1 2 3\n")
    yield _changed(sound, "obj", box_obj=b"# nothing\n")


def _configurations() -> Iterator[Case]:
    least = (
        "count: 10\nhidden: 3x4\nscenes: [{scene: chair}]\nhidden_images: [{kind: shapes}]\n"
        "ambient: [{kind: none}]\n"
    )
    laughs = "a0: &a0 [lol]\n" + "".join(
        f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 12)
    )
    merges = "a0: &a0 {k: 1}\n" + "".join(
        f"a{k}: &a{k} {{<<: [{', '.join([f'*a{k - 1}'] * 10)}]}}\n" for k in range(1, 12)
    )
    texts = [
        laughs, merges, least + laughs, least + merges, laughs + "count: *a11\n",
        least.replace("count: 10", laughs + "count: *a11"),
        least.replace("{scene: chair}", "{scene: chair, parameters: {x: {choice: *a11}}}") + laughs,
        laughs + least.replace("{scene: chair}", "{scene: chair, parameters: *a11}"),
        laughs + least.replace("[{kind: shapes}]", "*a11"), laughs + least.replace("[{kind: none}]",
                                                                                   "*a11"),
        "a: &a [*a]\n", "a: &a {b: *a}\n", "a: &a {<<: *a}\n", least + "sbr: &a {choice: [*a]}\n",
        least.replace("[{scene: chair}]", "&a [*a]"), least.replace("{kind: none}",
                                                                    "&a {kind: *a}"),
        "!!python/object/apply:os._exit [66]\n",
        least + "seed: !!python/object/apply:os._exit [66]\n",
        "!!python/name:os.system\n", "? [1, 2]\n: 3\n", "? {a: b}\n: 3\n", "[1]: 2\n",
        "{{a: 1}: 2}\n",
        "- " * 20_000, "[" * 100_000, "{a: " * 50_000, "? " * 20_000, "[" * 900, "a: " * 1000,
        "a: 1\n" * 100_000, "".join(f"k{k}: 1\n" for k in range(90_000)),
        "[" + "1," * 500_000 + "]", "- 1\n" * 250_000, "a: '" + "x" * 1_000_000,
        "# " + "x" * 1_000_000,
        "a" * 500_000, "a: |\n" + " x\n" * 300_000, "&a " * 100_000, "*a " * 100_000, "\x00",
        "\x85", "a: \x1b[2J",
        "%YAML 9.9\n---\n" + least, "---\n" * 1000, least + "---\n" + least,
        "%TAG ! tag:\n---\n!x 1", "!!set {a}",
        "!!binary x", "!!timestamp 2000-99-99", "2000-99-99", "a: 2000-13-45", "!!int x",
        "!!float x", "!!omap [a]",
        "!!bool x", "!!null x", "190:20:30", "0b", "0x", "1" * 5000, "1" * 200_000, "-" * 200_000,
        "\ufeff" + least,
        "a: !!int " + "1" * 5000, "a: !!float " + ":".join(["1"] * 5000), "0o" + "7" * 6000,
        "0x" + "f" * 200_000,
    ]  # fmt: skip
    for name in ("count", "hidden", "scenes", "hidden_images", "ambient"):
        for value in ("null", "[]", "{}", "''", "-1", "1e400", ".nan", ".inf", "2000-01-01", "yes",
                      "!!binary aGk=",
                      "!!set {a}", "9" * 400, "[[[]]]", "{a: {b: c}}", "3x4x5", "0x0",
                      "9999999x9999999", "٣x٤", "²x²",
                      "[3, 4]", "[3, 4, 5]", "[3.5, 4]", "[1e400, 1]", "[{kind: x}]",
                      "[{kind: [x]}]", "[{scene: 1}]",
                      '"\\x1b[2J"', '"a\\nb"', "{? {a: b} : c}"):  # fmt: skip
            lines = [line for line in least.splitlines() if not line.startswith(name + ":")]
            texts.append("\n".join([*lines, f"{name}: {value}", ""]))
    for name in ("sbr", "snr", "exposure", "saturation", "seed", "light", "splits", "clip_length",
                 "photograph_type",
                 "samples_per_shard", "samples_per_geometry", "keep_background",
                 "folder"):  # fmt: skip
        for value in ("null", "[]", "{}", ".nan", ".inf", "-1", "1e308", "{uniform: [.nan, 1]}",
                      "{choice: []}",
                      "{normal: [1, .inf]}", "{value: 1, choice: [1]}", "9" * 400,
                      "{kind: direct, samples: 1e9}",
                      "{train: .nan}", "{train: 1, validation: 0, test: 0}",
                      "'" + "9" * 5000 + "'"):  # fmt: skip
            texts.append(f"{least}{name}: {value}\n")
    for text in texts:
        yield Case("configuration", "hostile yaml", {"c.yaml": text.encode()})
    for raw in (
        b"\xff\xfe",
        b"\xff" * 100,
        b"a: \xc3\x28",
        "a: 1".encode("utf-16"),
        b"a: \xed\xa0\x80",
        bytes(9999),
    ):
        yield Case("configuration", "hostile yaml", {"c.yaml": raw})
