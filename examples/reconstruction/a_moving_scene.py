"""
A scene that moves
==================

A ball crosses the monitor. A video of the wall shows only a glow that changes a little. The method
recovers the ball, one photograph at a time.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

hidden = (15, 18)
scene = ps.load_scenario("chair", hidden, {"resolution": 63})

# %%
# The clip: 16 frames of an orange ball before a dark blue wall.

frames = 16
v, u = np.mgrid[: hidden[0], : hidden[1]]
phase = np.linspace(0, 1, frames)
column, row = 2 + 13 * phase, 11 - 9 * np.abs(np.sin(2 * np.pi * phase))
distance = np.hypot(u - column[:, None, None], v - row[:, None, None])
ball = np.clip(2.6 - distance, 0, 1)[..., None]
clip = ball * np.array([1.0, 0.4, 0.05]) + (1 - ball) * np.array([0.02, 0.05, 0.12])

# %%
# A steady lamp also lights the wall, as brightly as the monitor in the mean (an SBR of 1).

signal = (scene.A @ clip.reshape(frames, -1, 3)).reshape(frames, 63, 63, 3)
lamp = ps.point_light_backgrounds(scene, np.array([[-1.2, 1.9, 0.4]])).reshape(63, 63, 1)
light = signal + lamp * signal.mean() / lamp.mean()
photographs = [ps.add_noise(y, snr=60, seed=k) for k, y in enumerate(light)]

# %%
# ``next_frame`` accepts one photograph after the other, as a camera makes them. It draws each patch
# towards its colour in the previous frame.

video = ps.NoiseAwareVideo(scene.method("noise-aware"))
images = np.array([video.next_frame(photograph) for photograph in photographs])

shown = range(1, frames, 3)
figure, axes = plt.subplots(3, len(shown), figsize=(6, 3.5))
for column_of_axes, k in zip(axes.T, shown, strict=True):
    pictures = (
        ps.to_srgb(photographs[k], np.percentile(light, 99.5)),
        ps.to_srgb(ps.gain_matched(images[k], clip[k]), 1),
        ps.to_srgb(clip[k], 1),
    )
    for ax, picture in zip(column_of_axes, pictures, strict=True):
        ax.imshow(picture)
        ax.set_xticks([])
        ax.set_yticks([])
        ax.spines[:].set_visible(False)
    column_of_axes[0].set_title(f"frame {k}")
for ax, name in zip(axes[:, 0], ("photograph", "reconstruction", "hidden"), strict=True):
    ax.set_ylabel(name)

# %%
# The centroid of the orange light in each frame, compared with the ball's true place:

orange = np.clip(images[..., 0] - images[..., 2], 0, None) ** 2
weight = orange / orange.sum(axis=(1, 2), keepdims=True)
centroid = np.array([(weight * u).sum(axis=(1, 2)), (weight * v).sum(axis=(1, 2))])
error = np.hypot(*(centroid - [column, row]))
print(f"error of the ball's place: {np.sqrt(np.mean(error**2)):.2f} patches (root mean square)")

figure, ax = plt.subplots(figsize=(4.2, 3.2))
ax.plot(column, row, color="0.6", label="true")
ax.plot(*centroid, "o", markersize=4, label="reconstructed")
ax.set(xlim=(-0.5, 17.5), ylim=(14.5, -0.5), aspect="equal", xlabel="column", ylabel="row")
ax.legend()
assert np.sqrt(np.mean(error**2)) < 1
# sphinx_gallery_thumbnail_number = 1
