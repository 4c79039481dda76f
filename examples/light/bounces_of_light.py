"""
Light that bounces
==================

The light transport matrix knows one way: from the monitor to the wall, past the chair. In a bright
room light also takes detours, by a table, a shelf or the ceiling. Path tracing tells how much.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

hidden = (15, 18)
scene = ps.load_scenario("bright_room", hidden, {"resolution": 63})
image = ps.read_hidden_image(ps.find_image("mushroom"), hidden)
direct = ps.render_photograph(scene, image, samples=1024, bounces=1)
all_bounces = ps.render_photograph(scene, image, samples=1024)
bounced = all_bounces - direct
share = bounced.mean() / all_bounces.mean()
print(f"{100 * share:.0f} % of the light has bounced")
assert 0.05 < share < 0.2

# %%
# The detours take the room's colours along: a warm side wall, a blue shelf. They have no edges:
# light that has bounced comes from everywhere, and the chair casts no shadow of everywhere.

figure, axes = plt.subplots(1, 3, figsize=(7.2, 2.6))
white = np.percentile(all_bounces, 99.5)
panels = [
    ("directly", direct, white),
    ("by way of the room (× 5)", bounced, white / 5),
    ("all of it", all_bounces, white),
]
for ax, (title, light, level) in zip(axes, panels, strict=True):
    ax.imshow(ps.to_srgb(light, level))
    ax.set_title(title)
    ax.set_axis_off()

# %%
# So it looks like ambient light, and goes where ambient light goes: into range(B), which the
# methods project out. What is left of it is close to the path tracer's own noise.

U, s, _ = np.linalg.svd(ps.point_light_backgrounds(scene), full_matrices=False)
Q = U[:, s > 1e-10 * s[0]]


def left(y):
    flat = y.reshape(-1, 3)
    return np.linalg.norm(flat - Q @ (Q.T @ flat)) / np.linalg.norm(flat)


print(f"beyond range(B): {100 * left(direct):.1f} % of direct light")

# %%
# A reconstruction by the matrix of direct light therefore hardly suffers from light that is not in
# it.

A, B = ps.transport(scene), ps.point_light_backgrounds(scene)
method = ps.NoiseAware.for_scene(scene, A, B)
found = {
    name: method.reconstruct(ps.add_noise(light, snr=50, seed=0))
    for name, light in [("direct light alone", direct), ("all bounces", all_bounces)]
}
scores = {name: ps.psnr_gain_matched(f, image) for name, f in found.items()}
ps.show(
    image,
    *(ps.gain_matched(f, image) for f in found.values()),
    titles=["hidden", *(f"{name}: {score:.1f} dB" for name, score in scores.items())],
)
assert abs(np.diff(list(scores.values())).item()) < 3
# sphinx_gallery_thumbnail_number = 1
