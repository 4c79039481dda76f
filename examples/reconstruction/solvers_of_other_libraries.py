"""
Solvers of SciPy and PyLops on A
================================

The light transport is a linear operator, for which other libraries have good solvers.
:func:`~periscopy_sim.transport_operator` returns a SciPy operator over images, which PyLops
accepts.
"""

import matplotlib.pyplot as plt
import numpy as np
import pylops
from scipy.optimize import nnls
from scipy.sparse.linalg import lsqr

import periscopy_sim as ps

hidden = (15, 18)
scene = ps.load_scenario("chair", hidden, {"resolution": 63})
A = ps.transport_operator(scene)
truth = scene.image("mushroom")
clean = A @ truth.ravel()
photograph = ps.add_noise(A.photograph(clean), snr=60, seed=0)
y = photograph.ravel().astype(np.float32)
print(f"{A.shape[0]} measurements of {A.shape[1]} unknowns: three colours")

# %%
# The dot test checks that the operator and its adjoint match.

rng = np.random.default_rng(0)
x, z = (rng.standard_normal(n).astype(np.float32) for n in A.shape[::-1])
assert np.isclose(np.vdot(A @ x, z), np.vdot(x, A.rmatvec(z)), rtol=1e-3)

# %%
# LSQR regularizes by the number of its iterations: they first explain the image and then the noise.
# PyLops adds terms, here small differences of neighbouring patches. SciPy's ``nnls`` returns the
# nonnegative image that explains the photograph best; it needs the matrix itself.

counts = [5, 10, 20, 50, 100, 200, 500, 1000]
by_count = [A.image(lsqr(A, y, atol=0, btol=0, conlim=0, iter_lim=n)[0]) for n in counts]
scores = [ps.psnr_gain_matched(image, truth) for image in by_count]

matrix = scene.A
largest = np.linalg.norm(matrix, 2)
differences = [
    pylops.FirstDerivative((*hidden, 3), axis=axis, kind="forward", dtype="float32")
    for axis in (0, 1)
]
smooth = pylops.optimization.leastsquares.regularized_inversion(
    pylops.aslinearoperator(A), y, differences, epsRs=[2e-4 * largest] * 2,
    iter_lim=500, atol=0, btol=0,
)[0].reshape(truth.shape)  # fmt: skip

by_channel = y.reshape(-1, 3).astype(float).T
positive = np.transpose([nnls(matrix.astype(float), channel)[0] for channel in by_channel])
positive = positive.reshape(truth.shape)

# %%
# None of these solvers models ambient light. If there is any, project range(B) out first, or use
# :class:`~periscopy_sim.NoiseAware`, which also regularizes better.

noise_aware = scene.method("noise-aware", photograph).reconstruct(photograph)
best = int(np.argmax(scores))
images = {
    "hidden": truth,
    f"LSQR, {counts[best]}": by_count[best],
    "LSQR, 1000": by_count[-1],
    "PyLops, smooth": smooth,
    "f ≥ 0": positive,
    "noise-aware": noise_aware,
}
figure = plt.figure(figsize=(6, 5.2))
top, bottom = figure.subfigures(2, 1, height_ratios=[1.3, 1.2])
for ax, (name, result) in zip(top.subplots(2, 3).flat, images.items(), strict=True):
    ax.imshow(ps.to_srgb(ps.gain_matched(result, truth), 1))
    ax.set_title(
        name if name == "hidden" else f"{name}\n{ps.psnr_gain_matched(result, truth):.1f} dB"
    )
    ax.set_axis_off()
ax = bottom.subplots()
ax.semilogx(counts, scores, "o-", markersize=4, label="LSQR")
for name, result, style in [
    ("PyLops, smooth", smooth, "--"), ("f ≥ 0", positive, "-."), ("noise-aware", noise_aware, ":")
]:  # fmt: skip
    ax.axhline(
        ps.psnr_gain_matched(result, truth), linestyle=style, color="0.4", label=name, linewidth=1.2
    )
ax.set(xlabel="iterations of LSQR", ylabel="PSNR, dB")
ax.legend(ncols=2)
assert scores[best] >= scores[-1]
assert ps.psnr_gain_matched(noise_aware, truth) > max(
    ps.psnr_gain_matched(smooth, truth), ps.psnr_gain_matched(positive, truth)
)
