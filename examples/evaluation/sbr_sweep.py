"""
Three methods over ambient light
================================

Three methods get the same photographs under more and more ambient light, as in the paper's Fig. 4.
A sweep returns an xarray data set.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("chair", (15, 18), {"resolution": 63})
truth = scene.image("mushroom")

# %%
# Three places of ambient light have six lamps each, at random before the wall. ``flips`` adds their
# mirror images about each axis, twelve backgrounds in all.

rng = np.random.default_rng(0)
rooms = {}
for name in ("room 1", "room 2", "room 3"):
    lamps = rng.uniform([-2.5, 1.2, -1.0], [2.5, 4.0, 2.5], (6, 3))
    colours = rng.uniform(0.5, 1, (6, 3))
    rooms[name] = (ps.point_light_backgrounds(scene, lamps) @ colours).reshape(63, 63, 3)

methods = ["noise-aware", "preconditioned", "truncated-svd"]
sbrs = [0.05, 0.2, 1, 5, 20]
results = ps.sweep(scene, ["mushroom"], methods=methods, ambient=rooms, flips=True, sbr=sbrs)
print(results.mean_squared_error.sizes)
results = results.squeeze()

# %%
# Lines are means over the twelve backgrounds, bands extend from the 10th to the 90th percentile.

figure, ax = plt.subplots(figsize=(5.2, 3.6))
for name in methods:
    error = results.mean_squared_error.sel(algorithm=name)
    low, high = error.quantile([0.1, 0.9], dim="background").values
    (line,) = ax.loglog(results.sbr, error.mean("background"), "o-", markersize=3, label=name)
    ax.fill_between(results.sbr, low, high, color=line.get_color(), alpha=0.18, linewidth=0)
ax.set(xlabel="signal-to-background ratio", ylabel="mean squared error")
ax.grid(linewidth=0.4, color="0.85")
ax.legend()

mean = results.mean_squared_error.mean("background")
assert (mean.sel(algorithm="noise-aware") < mean.sel(algorithm="preconditioned")).all()

# %%
# The sweep keeps every image: look at those behind a surprising number.

figure, axes = plt.subplots(3, 5, figsize=(6, 3.4))
for row, name in zip(axes, methods, strict=True):
    for ax, sbr in zip(row, sbrs, strict=True):
        image = results.reconstruction.sel(algorithm=name, background="room 1", sbr=sbr).values
        ax.imshow(ps.to_srgb(ps.gain_matched(image, truth), 1))
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
    row[0].set_ylabel(name)
for ax, sbr in zip(axes[0], sbrs, strict=True):
    ax.set_title(f"SBR {sbr:g}")
# sphinx_gallery_thumbnail_number = 1
