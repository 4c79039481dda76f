"""
Where to look
=============

Which part of the wall should the camera photograph? The scene alone determines how well a
photograph shows hidden images. The Cramér-Rao bound is the least error of any unbiased method, so
the best view has the least bound.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("chair", (8, 10), {"resolution": 32})


def mean_bound(view):
    """Return the bound's mean over patches, for noise of a thousandth of a white image's light."""
    A = ps.analytic_transport(view)
    noise = 1e-3 * np.sqrt(np.mean(A.astype(float).sum(axis=1) ** 2))
    try:
        return noise * np.sqrt(ps.form_preconditioner(A, view.B).noise_gain.mean())
    except ValueError:  # the photograph does not determine some patch
        return np.nan


# %%
# The field of view moves over the wall; chair and monitor stay. ``ps.design`` does the same with an
# A as fine as photographs need.

dx, dz = np.linspace(-0.2, 0.2, 9), np.linspace(-0.24, 0.16, 9)
bounds = np.array([[mean_bound(scene.at(camera_dx=x, camera_dz=z)) for x in dx] for z in dz])
row, column = np.unravel_index(np.nanargmin(bounds), bounds.shape)
print(
    f"least {100 * bounds[row, column]:.1f} % of white, where the view moves "
    f"{100 * dx[column]:+.0f} cm to the right and {100 * dz[row]:+.0f} cm up"
)
print(f"at the paper's view it is {100 * mean_bound(scene):.1f} %")

figure, ax = plt.subplots(figsize=(5.4, 3.6))
ax.set_facecolor("0.85")  # where the photograph does not determine some patch
percent = 100 * bounds
least = np.nanmin(percent)
shown = ax.pcolormesh(100 * dx, 100 * dz, percent, cmap="viridis_r", vmin=least, vmax=6 * least)
figure.colorbar(shown, label="mean standard error, % of white", extend="max")
ax.plot(0, 0, "k+", markersize=10, label="the paper's view")
ax.plot(100 * dx[column], 100 * dz[row], "k*", markersize=11, label="the best of these")
ax.set(xlabel="view moved to the right, cm", ylabel="view moved up, cm", aspect="equal")
ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)

# %%
# Does the bound predict the error of a method? Compare a photograph of the best view with one of
# the worst.

finite = np.where(np.isfinite(bounds), bounds, -np.inf)
worst = np.unravel_index(finite.argmax(), bounds.shape)
truth = scene.image("mushroom")
images, scores = [], []
for place in ((row, column), worst):
    view = scene.at(camera_dx=dx[place[1]], camera_dz=dz[place[0]])
    light = (view.A @ truth.reshape(-1, 3)).reshape(32, 32, 3)
    method = view.method("noise-aware")
    images.append(method.reconstruct(ps.add_noise(light, snr=60, seed=0)))
    scores.append(ps.psnr_gain_matched(images[-1], truth))
ps.show(
    truth,
    *(ps.gain_matched(image, truth) for image in images),
    titles=["hidden", f"best view: {scores[0]:.1f} dB", f"worst view: {scores[1]:.1f} dB"],
)
assert scores[0] > scores[1] + 3
# sphinx_gallery_thumbnail_number = 1
