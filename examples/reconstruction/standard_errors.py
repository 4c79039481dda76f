"""
Standard errors beside true errors
==================================

The noise-aware method reports a standard error for each patch, from one photograph. This script
compares the reported errors with the true ones over many photographs.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("chair", (15, 18), {"resolution": 63})
method = scene.method("noise-aware", errors={})  # the scene's numbers are exact

# %%
# Fifteen photographs of one image under one lamp; only the noise differs.

truth = scene.image("mushroom")
signal = (scene.A @ truth.reshape(-1, 3)).reshape(63, 63, 3)
lamp = ps.point_light_backgrounds(scene, np.array([[-1.2, 1.9, 0.4]])).reshape(63, 63, 1)
clean = ps.composite(signal, np.broadcast_to(lamp, signal.shape), sbr=1)
photographs = [ps.add_noise(clean, snr=55, seed=seed) for seed in range(15)]

solutions = [method.solve(photograph) for photograph in photographs]
reported = method.standard_errors(solutions[0])

# %%
# A composite has a mean of 1, so the image is in that unit. The monitor's light was scaled by
# SBR / (1 + SBR) over its mean, and the truth is scaled alike.

unit = 0.5 / signal.mean()
errors = np.array([f.image - unit * truth for f in solutions])
true = np.sqrt(np.mean(errors**2, axis=(0, 3)))
reported = np.sqrt(np.mean(reported**2, axis=2))

white = unit * truth.max() / 100
figure, axes = plt.subplots(2, 2, figsize=(6, 4.6))
axes[0, 0].imshow(ps.to_srgb(solutions[0].image, unit))
axes[0, 0].set_title("reconstruction")
top = 1.02 * max(reported.max(), true.max()) / white
for ax, name, values in zip(
    axes[1], ("reported, % of white", "true, % of white"), (reported, true), strict=True
):
    shown = ax.imshow(values / white, cmap="magma", vmin=0, vmax=top)
    ax.set_title(name)
figure.colorbar(shown, ax=axes[1], shrink=0.9)
for ax in (axes[0, 0], *axes[1]):
    ax.set_axis_off()
axes[0, 1].plot([0, top], [0, top], color="0.6", linewidth=1)
axes[0, 1].scatter(reported / white, true / white, s=7, alpha=0.6, linewidth=0)
axes[0, 1].set(xlabel="reported, %", ylabel="true, %", xlim=(0, top), ylim=(0, top), box_aspect=1)

# %%
# For normal errors the truth is within one standard error in 68 % of all cases, and within two in
# 95 %. Here the fractions are larger: where the image is black the reported errors are too large,
# since they ignore that light cannot be negative. At the bright spots they are too small, because
# total variation smooths these spots in every photograph.

within = [np.mean(np.abs(errors) <= k * method.standard_errors(solutions[0])) for k in (1, 2)]
print(f"within one: {100 * within[0]:.0f} %, within two: {100 * within[1]:.0f} %")
print(
    f"reported over true, root mean square: {np.sqrt(np.mean(reported**2) / np.mean(true**2)):.2f}"
)
assert 0.5 < within[0] < 0.95 and within[1] > 0.8
