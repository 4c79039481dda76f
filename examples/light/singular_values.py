"""
Why a chair helps: singular values
==================================

How many numbers of the hidden image does a photograph contain? Each singular value of the light
transport matrix is the strength of one pattern of the monitor on the wall. Noise hides the weak
patterns, which are nearly all of them without an occluder.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

hidden = (15, 18)
# Points of a quadrature, not random rays: noise of A would hide its small singular values.
light = ps.Light(by="rays", samples=64, strata="gauss")
chair, plate = (
    ps.load_scenario(name, hidden, {"resolution": 63}, light=light) for name in ("chair", "plate")
)
scenes = {
    "a chair": chair,
    "a plate on a stick": plate,
    "nothing": chair.at(occluder_dz=-3),  # far below
}
values = {
    name: np.linalg.svd(scene.A.astype(float), compute_uv=False) for name, scene in scenes.items()
}

# %%
# Let the image have equal strength in all N patterns. Nearly all of its light on the wall is then
# the first pattern's, whose singular value is the largest. Noise of 60 dB has a thousandth of that
# light's root mean square in each of the M pixels. Pattern k is stronger than the noise if its
# singular value is more than :math:`10^{-3} \sqrt{N / M}` of the first.

N, M = hidden[0] * hidden[1], 63 * 63
floor = 1e-3 * np.sqrt(N / M)
strong = {name: int((s > floor * s[0]).sum()) for name, s in values.items()}
for name, count in strong.items():
    print(f"between monitor and wall {name}: {count} of {N} patterns")
assert strong["nothing"] < 15 and min(strong["a chair"], strong["a plate on a stick"]) > 200

figure, ax = plt.subplots(figsize=(5.6, 3.4))
for name, s in values.items():
    ax.semilogy(np.arange(1, len(s) + 1), s / s[0], label=f"{name}: {strong[name]} patterns")
ax.axhline(floor, color="0.5", linestyle="--", linewidth=1)
ax.text(60, floor * 1.25, "noise at 60 dB", va="bottom", color="0.4")
ax.set(xlabel="singular value", ylabel="over the largest", xlim=(0, len(s)), ylim=(1e-8, 1.5))
ax.legend(title="between monitor and wall")

# %%
# The patterns are right singular vectors, here as the monitor would show them. The first are
# broad and strong, the last fine and weak.

V = np.linalg.svd(chair.A.astype(float), full_matrices=False)[2]
figure, axes = plt.subplots(1, 5, figsize=(6, 1.6))
for ax, k in zip(axes, (1, 3, 10, 50, 250), strict=True):
    pattern = V[k - 1].reshape(hidden)
    reach = np.abs(pattern).max()
    ax.imshow(pattern, cmap="RdBu_r", vmin=-reach, vmax=reach)
    ax.set_title(f"pattern {k}")
    ax.set_axis_off()
# sphinx_gallery_thumbnail_number = 1
