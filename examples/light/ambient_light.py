"""
How the paper removes ambient light
===================================

Lamps and windows light the wall too, often more than the monitor does. The paper's idea: light
from afar changes slowly over the wall, so nearly all of it lies in a space of few dimensions.
Methods project this space out.
"""

# %%
# Eq. 4 of the paper: the wall under a point light at :math:`\alpha` is
# :math:`\psi(\alpha)_i = (\alpha - c_i) \cdot n_i / \lVert \alpha - c_i \rVert^3`.
# Each light of a grid of 8 x 8 x 8 places in the room gives a column of :math:`B`.

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("chair", (15, 18), {"resolution": 63})
B = scene.B
U, s, _ = np.linalg.svd(B, full_matrices=False)
Q = U[:, s > 1e-10 * s[0]]
print(f"{B.shape[1]} lights, yet a basis of {Q.shape[1]} pictures holds their light to 1e-10")
assert Q.shape[1] < 100

# %%
# The first pictures of that basis (blue is negative) are a constant, planes, then parabolas. None
# resembles the edge of a shadow.

figure, axes = plt.subplots(1, 6, figsize=(6, 1.5))
for k, ax in enumerate(axes):
    picture = Q[:, k] * np.sign(Q[:, k].sum())
    reach = np.abs(picture).max()
    ax.imshow(picture.reshape(63, 63), cmap="RdBu_r", vmin=-reach, vmax=reach)
    ax.set_title(f"{k + 1}")
    ax.set_axis_off()

# %%
# The next photograph has the light of a sky, path traced with all bounces: the overcast place that
# ships with the package. The monitor's mushroom is half as bright (an SBR of 0.5).

signal = scene.photograph(scene.image("mushroom")).values
sky = scene.ambient("overcast", target=3e-3).photograph
photograph = ps.composite(signal, sky, sbr=0.5)


def without_ambient_light(y):
    """Project range(B) out of every channel."""
    flat = y.reshape(-1, 3)
    return (flat - Q @ (Q.T @ flat)).reshape(y.shape)


def strength(y):
    return np.sqrt(np.mean(y**2))


scale = signal.mean() / (0.5 * sky.mean())  # of the sky, beside the monitor's light
lights = {"the monitor's": signal, "the sky's": scale * sky}
for name, light in lights.items():
    share = strength(without_ambient_light(light)) / strength(light)
    print(f"{100 * share:.2f} % of {name} light lies outside range(B)")
kept = {name: strength(without_ambient_light(light)) for name, light in lights.items()}
assert kept["the monitor's"] > 5 * kept["the sky's"]

figure, axes = plt.subplots(1, 4, figsize=(6, 2.2))
axes[0].imshow(ps.to_srgb(signal))
axes[0].set_title("the monitor's\nlight")
axes[1].imshow(ps.to_srgb(photograph))
axes[1].set_title("under the sky")
for ax, title, light in zip(
    axes[2:],
    ["both,\nprojected", "the sky,\nprojected"],
    [signal + scale * sky, scale * sky],
    strict=True,
):
    rest = without_ambient_light(light).mean(axis=2)
    ax.imshow(rest, cmap="RdBu_r", vmin=-3 * kept["the monitor's"], vmax=3 * kept["the monitor's"])
    ax.set_title(title)
for ax in axes:
    ax.set_axis_off()
# sphinx_gallery_thumbnail_number = 2

# %%
# The projection removes the sky, and the smooth part of the monitor's light. The chair's shadows
# stay, and with them the image: :math:`A_\perp = A - Q Q^\top A` has full column rank, so
# :math:`f` is still determined. :func:`~periscopy_sim.form_preconditioner` makes the matrix
# :math:`P`, with :math:`P A = I` and :math:`P B = 0`.

A = scene.A.astype(float)
P = ps.form_preconditioner(A, B)
assert np.allclose(P.apply(A[:, :20]), np.eye(270)[:, :20], atol=1e-6)
residual = np.linalg.norm(P.apply(B), axis=0) / np.linalg.norm(B, axis=0)
print(f"P leaves {residual.max() / np.sqrt(P.noise_gain.max()):.1e} of a column of B")
