"""
A scene of your own
===================

A scene is a plain Mitsuba file. Three ids are the contract: a shape ``wall``, a shape ``monitor``
and a sensor ``camera``. Whatever else stands there is in the light's way. Here a ball hangs from a
rod; nothing of it ships with the package.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

XML = """<scene version="3.0.0">
    <default name="ball_x" value="0.05"/>
    <default name="pixels" value="63"/>

    <sensor type="orthographic" id="camera">
        <transform name="to_world">
            <scale x="0.22" y="0.22"/>
            <lookat origin="0, 0.7, 0.1" target="0, 1, 0.1" up="0, 0, 1"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$pixels"/>
            <integer name="height" value="$pixels"/>
        </film>
    </sensor>

    <shape type="rectangle" id="wall">
        <transform name="to_world">
            <scale x="1.5" y="1.5"/>
            <lookat origin="0, 1, 0" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>
    </shape>

    <shape type="rectangle" id="monitor">
        <transform name="to_world">
            <scale x="0.2" y="0.16"/>
            <lookat origin="0, 0, 0.1" target="0, 1, 0.1" up="0, 0, 1"/>
        </transform>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter>
    </shape>

    <shape type="sphere" id="ball">
        <point name="center" x="$ball_x" y="0.5" z="0.1"/>
        <float name="radius" value="0.045"/>
        <bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
    </shape>

    <shape type="cylinder" id="rod">
        <point name="p0" x="$ball_x" y="0.5" z="0.1"/>
        <point name="p1" x="$ball_x" y="0.5" z="1.0"/>
        <float name="radius" value="0.004"/>
        <bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
    </shape>
</scene>
"""
folder = Path(tempfile.mkdtemp())
file = folder / "ball.xml"
file.write_text(XML, "utf-8")

hidden = (12, 15)
scene = ps.load_scenario(file, hidden)
print(f"occluders: {', '.join(occluder.name for occluder in scene.occluders)}")

# %%
# Look at a scene before you use it. The arrays of a :class:`~periscopy_sim.Scenario` suffice for a
# plan, seen from above; ``periscopy draw ball.xml --out ball.png`` draws a better one.

figure, ax = plt.subplots(figsize=(6.4, 3.4))
for points, name, colour in [
    (scene.wall_points, "what the camera sees of the wall", "#0072B2"),
    (scene.patch_centers, "monitor", "#D55E00"),
]:
    ax.plot(points[:, 0], points[:, 1], color=colour, linewidth=3, label=name)
ball = next(occluder for occluder in scene.occluders if occluder.name == "ball")
center, radius = ball.bounds.mean(axis=0), np.ptp(ball.bounds[:, 0]) / 2
ax.add_patch(plt.Circle(center[:2], radius, color="0.3", label="ball"))
for x in (scene.patch_centers[:, 0].min(), scene.patch_centers[:, 0].max()):
    ax.plot([x, 2 * center[0] - x], [0, 1], color="0.75", linewidth=0.8, zorder=0)
ax.set(xlabel="x, m", ylabel="y, m", aspect="equal", xlim=(-0.45, 0.55), ylim=(-0.05, 1.05))
ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))

# %%
# All that follows is as for the shipped scenes.

A, B = ps.render_transport(scene, samples=64), ps.point_light_backgrounds(scene)
truth = ps.read_hidden_image(ps.find_image("letters"), hidden)
signal = ps.render_photograph(scene, truth, samples=1024, bounces=1)
photograph = ps.add_noise(signal, snr=60, seed=0)
image = ps.NoiseAware.for_scene(scene, A, B).reconstruct(photograph)
score = ps.psnr(image, truth)
ps.show(
    photograph,
    ps.gain_matched(image, truth),
    truth,
    titles=["the wall", f"found: {score:.1f} dB", "hidden"],
)
assert score > 18

# %%
# What the file declares as ``<default>`` is set without touching it. With the ball 3 cm elsewhere
# the shadow moves, and by how much the file need not be read for.

moved = ps.load_scenario(file, hidden, {"ball_x": 0.08})
there = (ps.render_transport(moved, samples=64) @ truth.reshape(-1, 3)).reshape(signal.shape)
assert np.abs(there - signal).max() > 0.05 * signal.max()
# sphinx_gallery_thumbnail_number = 2
