"""
Light that bounces
==================

The light transport matrix has one path: from the monitor to the wall, past the chair. In a bright
room a table, a shelf or the ceiling also reflect light to the wall. Path tracing shows how much.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("bright_room", (15, 18), {"resolution": 63})
image = scene.image("mushroom")
direct = scene.photograph(image, bounces=1).values
all_bounces = scene.photograph(image).values
bounced = all_bounces - direct
share = bounced.mean() / all_bounces.mean()
print(f"{100 * share:.0f} % of the light has bounced")
assert 0.05 < share < 0.2

# %%
# Bounced light has the room's colours: a warm side wall, a blue shelf. It comes from all
# directions, so the chair's shadow of it has no edges.

figure, axes = plt.subplots(1, 3, figsize=(6, 2.4))
white = np.percentile(all_bounces, 99.5)
panels = [
    ("direct light", direct, white),
    ("bounced light (× 5)", bounced, white / 5),
    ("all light", all_bounces, white),
]
for ax, (title, light, level) in zip(axes, panels, strict=True):
    ax.imshow(ps.to_srgb(light, level))
    ax.set_title(title)
    ax.set_axis_off()

# %%
# Like ambient light, bounced light lies near range(B), which the methods project out. Its residual
# is close to the path tracer's own noise.

U, s, _ = np.linalg.svd(scene.B, full_matrices=False)
Q = U[:, s > 1e-10 * s[0]]


def outside(y):
    flat = y.reshape(-1, 3)
    return np.linalg.norm(flat - Q @ (Q.T @ flat)) / np.linalg.norm(flat)


print(f"beyond range(B): {100 * outside(direct):.1f} % of direct light")

# %%
# A reconstruction with the matrix of direct light is therefore nearly as good with all bounces.

method = scene.method("noise-aware")
images = {
    name: method.reconstruct(ps.add_noise(light, snr=50, seed=0))
    for name, light in [("direct light alone", direct), ("all bounces", all_bounces)]
}
scores = {name: ps.psnr_gain_matched(f, image) for name, f in images.items()}
ps.show(
    image,
    *(ps.gain_matched(f, image) for f in images.values()),
    titles=["hidden image", *(f"{name}: {score:.1f} dB" for name, score in scores.items())],
)
assert abs(np.diff(list(scores.values())).item()) < 3
# sphinx_gallery_thumbnail_number = 1
