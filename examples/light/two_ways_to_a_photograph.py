"""
A photograph computed twice
===========================

This package computes a photograph in two ways that share no code: rays, which Mitsuba traces, and
a closed form, which projects the chair's triangles onto the wall. Both agree in absolute scale.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("chair", (15, 18), {"resolution": 63})
image = scene.image("still_life")

closed_form = (ps.analytic_transport(scene) @ image.reshape(-1, 3)).reshape(63, 63, 3)
shadow_rays = ps.render_transport(scene.averaged(3), samples=64) @ image.reshape(-1, 3)
shadow_rays = shadow_rays.reshape(63, 63, 3)

# %%
# The third photograph is path traced, with the image on the monitor. It averages over each pixel,
# and two seeds show its noise.

traced = [
    ps.render_photograph(scene, image, samples=576, bounces=1, only_monitor=True, seed=seed)
    for seed in (0, 1)
]
noise = np.std(traced[0] - traced[1]) / np.sqrt(2)
mean = np.mean(traced, axis=0)
print(f"brightness, rays over path tracing: {shadow_rays.sum() / mean.sum():.5f}")
print(f"brightness, closed form over path tracing: {closed_form.sum() / mean.sum():.5f}")
assert abs(shadow_rays.sum() / mean.sum() - 1) < 1e-3
assert abs(closed_form.sum() / mean.sum() - 1) < 2e-3

# %%
# Rays and path tracing differ only by the path tracer's noise. The closed form uses the middle of
# each pixel, so it differs at the edges of shadows.

figure, axes = plt.subplots(1, 4, figsize=(6, 2.0))
axes[0].imshow(ps.to_srgb(mean))
axes[0].set_title("path traced")
axes[1].imshow(ps.to_srgb(closed_form))
axes[1].set_title("closed form")
for ax, title, light in zip(
    axes[2:],
    ["rays,\ndifference", "closed form,\ndifference"],
    [shadow_rays, closed_form],
    strict=True,
):
    difference = 100 * (light - mean).mean(axis=2) / mean.mean()
    shown = ax.imshow(difference, cmap="RdBu_r", vmin=-2, vmax=2)
    ax.set_title(title)
for ax in axes:
    ax.set_axis_off()
figure.colorbar(shown, ax=axes, shrink=0.95, label="% of the mean", aspect=15)

ratio = np.sqrt(np.mean((shadow_rays - mean) ** 2)) / (noise / np.sqrt(2))
print(f"rays and path tracing differ by {ratio:.2f} times what noise would make")
assert ratio < 1.3
