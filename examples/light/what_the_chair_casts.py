"""
What the chair casts
====================

A camera sees a blank wall. Around the corner a monitor lights it, and a chair stands between.
If a single patch of the monitor shines, the wall shows the chair's shadow. Another patch casts the
shadow elsewhere. These pictures are the columns of the **light transport matrix**, :math:`A`, and
describe the whole experiment.
"""

# %%
# A scene is a Mitsuba file; the paper's chair experiment ships with the package. Parameters set its
# ``<default>``\ s: here the photograph has 63 x 63 pixels. The hidden image has 15 rows of 18
# patches.

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

hidden = (15, 18)
scene = ps.load_scenario("chair", hidden, {"resolution": 63})
A = ps.render_transport(scene, samples=64)
print(f"A has {A.shape[0]} rows, one a pixel, and {A.shape[1]} columns, one a patch")

# %%
# Each column is a photograph of the shadow that one patch casts. A patch is not a point, so the
# shadow has a soft edge: a **penumbra**. If the patch moves to a viewer's right on the monitor, the
# shadow moves to a viewer's right on the wall. If the patch moves down, the shadow moves up.

wall = scene.photograph_shape
patches = [(7, 2), (7, 9), (7, 15), (1, 9), (13, 9)]
figure, axes = plt.subplots(1, 5, figsize=(6, 2.0))
for ax, (row, column) in zip(axes, patches, strict=True):
    light = A[:, row * hidden[1] + column].reshape(wall)
    ax.imshow(light, cmap="gray", vmin=0, vmax=A.max())
    ax.set_title(f"row {row},\ncolumn {column}")
    ax.set_axis_off()

# %%
# A monitor that shows an image :math:`f` lights all patches at once, and light adds up: the
# photograph is :math:`y = A f`. It does not look like the image.

image = scene.image("mushroom")
photograph = (A @ image.reshape(-1, 3)).reshape(*wall, 3)
ps.show(image, photograph, titles=["what the monitor shows", "the wall, A f"])

one_by_one = sum(np.outer(A[:, j], f) for j, f in enumerate(image.reshape(-1, 3)))
assert np.allclose(one_by_one.reshape(photograph.shape), photograph, rtol=1e-4)

# %%
# The photograph still contains the image. Without the chair the wall shows a smooth glow. Divided
# by that glow, the photograph shows the chair's shadows, whose edges are blurred pictures of the
# monitor.

away = scene.at(occluder_dz=-3)
glow = (ps.render_transport(away, samples=64) @ image.reshape(-1, 3)).reshape(photograph.shape)
assert (photograph <= glow * 1.0001).all(), "an occluder adds no light"

figure, axes = plt.subplots(1, 3, figsize=(6, 2.5))
white = np.percentile(glow, 99.5)
for ax, (title, light) in zip(
    axes, [("no chair", glow), ("the chair's shadow", photograph)], strict=False
):
    ax.imshow(ps.to_srgb(light, white))
    ax.set_title(title)
shadow = axes[2].imshow((photograph / glow).mean(axis=2), cmap="magma", vmin=0, vmax=1)
axes[2].set_title("fraction of light\nthat passes")
figure.colorbar(shadow, ax=axes[2], shrink=0.8)
for ax in axes:
    ax.set_axis_off()
# sphinx_gallery_thumbnail_number = 1
