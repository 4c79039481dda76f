"""
What the chair casts
====================

A camera sees a blank wall. Around the corner a monitor lights it, and a chair stands between.
Let a single patch of the monitor shine: the wall shows the chair's shadow. Another patch throws
the shadow elsewhere. These pictures are all that is needed to describe the experiment. They are
the columns of the **light transport matrix**, :math:`A`.
"""

# %%
# A scene is a Mitsuba file; the chair experiment of the paper is one of those that ship. Its
# ``<default>``\ s may be set: here the photograph has 63 x 63 pixels. The hidden image has 15 rows
# of 18 patches.

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

hidden = (15, 18)
scene = ps.load_scenario("chair", hidden, {"resolution": 63})
A = ps.render_transport(scene, samples=64)
print(f"A has {A.shape[0]} rows, one a pixel, and {A.shape[1]} columns, one a patch")

# %%
# Each column is a photograph: of the shadow that one patch makes the chair cast. A patch is not a
# point, and so the shadow's edge is a little soft: a **penumbra**. As the patch goes to the right,
# as one faces the monitor, so does the shadow, as one faces the wall: the other way in the room. As
# the patch goes down, the shadow goes up.

wall = scene.photograph_shape
patches = [(7, 2), (7, 9), (7, 15), (1, 9), (13, 9)]
figure, axes = plt.subplots(1, 5, figsize=(7.2, 2.0))
for ax, (row, column) in zip(axes, patches, strict=True):
    light = A[:, row * hidden[1] + column].reshape(wall)
    ax.imshow(light, cmap="gray", vmin=0, vmax=A.max())
    ax.set_title(f"row {row}, column {column}")
    ax.set_axis_off()

# %%
# A monitor that shows an image :math:`f` is many patches at once, and light adds up: the wall is
# :math:`y = A f`. Nothing in the sum looks like the image any more.

image = ps.read_hidden_image(ps.find_image("mushroom"), hidden)
photograph = (A @ image.reshape(-1, 3)).reshape(*wall, 3)
ps.show(image, photograph, titles=["what the monitor shows", "the wall, A f"])

one_by_one = sum(np.outer(A[:, j], f) for j, f in enumerate(image.reshape(-1, 3)))
assert np.allclose(one_by_one.reshape(photograph.shape), photograph, rtol=1e-4)

# %%
# Yet the image is still in there. Without the chair the wall would be an even glow. Divide by that
# glow, and what the chair has cast comes out: edges, each a blurred picture of the monitor.

away = ps.load_scenario("chair", hidden, {"resolution": 63, "occluder_dz": -3})
glow = (ps.render_transport(away, samples=64) @ image.reshape(-1, 3)).reshape(photograph.shape)
assert (photograph <= glow * 1.0001).all(), "an occluder adds no light"

figure, axes = plt.subplots(1, 3, figsize=(7.2, 2.7))
white = np.percentile(glow, 99.5)
for ax, (title, light) in zip(
    axes, [("no chair", glow), ("the chair's shadow", photograph)], strict=False
):
    ax.imshow(ps.to_srgb(light, white))
    ax.set_title(title)
shadow = axes[2].imshow((photograph / glow).mean(axis=2), cmap="magma", vmin=0, vmax=1)
axes[2].set_title("part of the light that passes")
figure.colorbar(shadow, ax=axes[2], shrink=0.8)
for ax in axes:
    ax.set_axis_off()
# sphinx_gallery_thumbnail_number = 1
