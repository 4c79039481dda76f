"""
A minimal scene
===============

A scene is a plain Mitsuba file. Three ids are the contract: a shape ``wall``, a shape ``monitor``
and a sensor ``camera``. Every other shape is an occluder. These 25 lines are a whole scene, in
metres: x to the right as you face the wall, y from the monitor to the wall, z up.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

XML = """<scene version="3.0.0">
    <sensor type="orthographic" id="camera">
        <transform name="to_world">
            <scale x="0.22" y="0.22"/>
            <lookat origin="0, 0.7, 0.1" target="0, 1, 0.1" up="0, 0, 1"/>
        </transform>
        <film type="hdrfilm"><integer name="width" value="63"/><integer name="height" value="63"/></film>
    </sensor>
    <shape type="rectangle" id="wall">
        <transform name="to_world">
            <scale value="1.5"/>
            <lookat origin="0, 1, 0" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
    </shape>
    <shape type="rectangle" id="monitor">
        <transform name="to_world">
            <scale x="0.2" y="0.16"/>
            <lookat origin="0, 0, 0.1" target="0, 1, 0.1" up="0, 0, 1"/>
        </transform>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter>
    </shape>
    <shape type="cube" id="box">
        <transform name="to_world"><scale value="0.04"/><translate x="0.05" y="0.5" z="0.1"/></transform>
    </shape>
</scene>
"""  # noqa: E501
folder = Path(tempfile.mkdtemp())
file = folder / "minimal.xml"
file.write_text(XML, "utf-8")
assert len(XML.splitlines()) == 25

# %%
# Look at a scene before you use it. In a shell: ``periscopy draw minimal.xml --out minimal.png``.

hidden = (12, 15)
scene = ps.load_scenario(file, hidden)
ps.draw(scene).savefig(folder / "minimal.png")
picture = plt.imread(folder / "minimal.png")
figure, ax = plt.subplots(figsize=(6, 6 * picture.shape[0] / picture.shape[1]))
ax.imshow(picture, interpolation="lanczos")
ax.set_axis_off()

# %%
# Everything else works as with the shipped scenes. In a shell: ``periscopy photograph minimal.xml
# letters --hidden 12x15 --snr 60 --out photo.exr``, then ``periscopy reconstruct photo.exr --scene
# minimal.xml --hidden 12x15 --out out``. The monitor shows 12 x 15 patches, as the image has.

truth = scene.image("letters")
photograph = scene.photograph(truth, snr=60, bounces=1)
image = scene.method("noise-aware", photograph).reconstruct(photograph)
score = ps.psnr_gain_matched(image, truth)
ps.show(
    photograph,
    ps.gain_matched(image, truth),
    truth,
    titles=["photograph", f"reconstruction: {score:.1f} dB", "hidden image"],
)
assert score > 18

# %%
# A ``<default name="box_x" value="0.05"/>`` in the file, and ``x="$box_x"`` in place of the number,
# make the place a parameter: ``-D box_x=0.08``, here ``parameters``. The shadow then moves.

declared = XML.replace("<sensor", '<default name="box_x" value="0.05"/>\n    <sensor', 1)
file.write_text(declared.replace('x="0.05"', 'x="$box_x"'), "utf-8")
moved = ps.load_scenario(file, hidden, {"box_x": 0.08})
signal, there = ((each.A @ truth.reshape(-1, 3)) for each in (scene, moved))
assert np.abs(there - signal).max() > 0.05 * signal.max()
# sphinx_gallery_thumbnail_number = 2
