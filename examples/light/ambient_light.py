"""
Ambient light, and how it is made to vanish
===========================================

A room is not dark. Lamps and windows light the wall too, often more than the monitor does. The
paper's idea: light from afar changes slowly over the wall, so nearly all of it lies in a space of
few dimensions, and that space can be left out of account.
"""

# %%
# Eq. 4 of the paper: the wall under a point light at :math:`\alpha` is
# :math:`\psi(\alpha)_i = (\alpha - c_i) \cdot n_i / \lVert \alpha - c_i \rVert^3`.
# Put lights on a grid of 8 x 8 x 8 places in the room, and each is a column of :math:`B`.

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

hidden = (15, 18)
scene = ps.load_scenario("chair", hidden, {"resolution": 63})
B = ps.point_light_backgrounds(scene)
U, s, _ = np.linalg.svd(B, full_matrices=False)
Q = U[:, s > 1e-10 * s[0]]
print(f"{B.shape[1]} lights, yet a basis of {Q.shape[1]} pictures holds their light to 1e-10")
assert Q.shape[1] < 100

# %%
# The first pictures of that basis (blue is negative): a plain one, planes, then parabolas. No edge
# of a shadow is like them.

figure, axes = plt.subplots(1, 6, figsize=(7.2, 1.5))
for k, ax in enumerate(axes):
    picture = Q[:, k] * np.sign(Q[:, k].sum())
    reach = np.abs(picture).max()
    ax.imshow(picture.reshape(63, 63), cmap="RdBu_r", vmin=-reach, vmax=reach)
    ax.set_title(f"{k + 1}")
    ax.set_axis_off()

# %%
# Now a real sky, path traced: the overcast place that ships with the package, with the light that
# its surroundings send on. Over it the monitor shows a mushroom, twice as faint (an SBR of 0.5).

image = ps.read_hidden_image(ps.find_image("mushroom"), hidden)
signal = ps.render_photograph(scene, image, samples=1024)
sky = ps.render_background("ambient/overcast", scene, target=3e-3).photograph
photograph = ps.composite(signal, sky, sbr=0.5)


def without_ambient_light(y):
    """Project range(B) out of every channel."""
    flat = y.reshape(-1, 3)
    return (flat - Q @ (Q.T @ flat)).reshape(y.shape)


def strength(y):
    return np.sqrt(np.mean(y**2))


scale = signal.mean() / (0.5 * sky.mean())  # of the sky, beside the monitor's light
left = {"the monitor's": signal, "the sky's": scale * sky}
for name, light in left.items():
    share = strength(without_ambient_light(light)) / strength(light)
    print(f"{100 * share:.2f} % of {name} light is left")
kept = {name: strength(without_ambient_light(light)) for name, light in left.items()}
assert kept["the monitor's"] > 5 * kept["the sky's"]

figure, axes = plt.subplots(1, 4, figsize=(7.2, 2.2))
axes[0].imshow(ps.to_srgb(signal))
axes[0].set_title("the monitor's light")
axes[1].imshow(ps.to_srgb(photograph))
axes[1].set_title("under the sky")
for ax, title, light in zip(
    axes[2:],
    ["left of both", "left of the sky"],
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
# Nothing is left of the sky that could be seen at this scale. The monitor's light, too, loses its
# smooth part. What the chair has cut out stays, and with it the image: :math:`A_\perp = A - Q
# Q^\top A` has full column rank, so :math:`f` is still determined.
# :func:`~periscopy_sim.form_preconditioner` makes the matrix :math:`P` of it, with :math:`P A = I`
# and :math:`P B = 0`.

A = ps.render_transport(scene, samples=64).astype(float)
P = ps.form_preconditioner(A, B)
assert np.allclose(P.apply(A[:, :20]), np.eye(270)[:, :20], atol=1e-6)
residual = np.linalg.norm(P.apply(B), axis=0) / np.linalg.norm(B, axis=0)
print(f"P leaves {residual.max() / np.sqrt(P.noise_gain.max()):.1e} of a column of B")
