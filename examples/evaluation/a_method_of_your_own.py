"""
A method of your own, beside the others
=======================================

A method is any object with ``reconstruct(photograph)``. Write a class in a file, and every command
and every sweep accepts its name, without a change of the package.
"""

# %%
# This is a whole file, ``tikhonov.py``. Its method projects ambient light out and penalizes the
# differences of neighbouring patches.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

SOURCE = '''
import numpy as np


class Tikhonov:
    """min ‖A⊥ f − y⊥‖² + μ ‖D f‖², D the differences of neighbouring patches."""

    weight = 1e-4

    def __init__(self, scenario, A, B):
        U, s, _ = np.linalg.svd(B, full_matrices=False)
        Q = U[:, s > 1e-10 * s[0]]
        projected = A - Q @ (Q.T @ A)  # A⊥
        D = scenario.hidden.differences.matrix.toarray()
        gram = projected.T @ projected
        mu = self.weight * np.trace(gram) / len(gram)
        self.inverse = np.linalg.solve(gram + mu * D.T @ D, projected.T)
        self.gain, self.shape = scenario.channel_gain, (*scenario.hidden_shape, 3)

    def reconstruct(self, photograph):
        return (self.inverse @ photograph.reshape(-1, 3) / self.gain).reshape(self.shape)
'''
folder = Path(tempfile.mkdtemp())
(folder / "tikhonov.py").write_text(SOURCE, "utf-8")

# %%
# ``--method tikhonov.py:Tikhonov`` gives it to a command. In Python the class itself serves, too.

scene = ps.load_scenario("chair", (15, 18), {"resolution": 63})
methods = {
    "Tikhonov": f"{folder / 'tikhonov.py'}:Tikhonov",
    "preconditioned": "preconditioned",
    "noise-aware": "noise-aware",
}

# %%
# All methods get the same photographs, at three ratios of the monitor's light to that of lamps.

truth = scene.image("letters")
lamps = ps.point_light_backgrounds(scene, np.array([[-1.2, 1.9, 0.4], [0.8, 2.6, 1.3]]))
room = (lamps @ [[1.0, 0.8, 0.6], [0.7, 0.8, 1.0]]).reshape(63, 63, 3)
results = ps.sweep(
    scene, ["letters"], methods=methods, ambient={"two lamps": room}, sbr=[0.1, 1, 10]
).squeeze()
assert not results.failure.values.any(), "each method gave an image of every photograph"

figure, axes = plt.subplots(3, 4, figsize=(6, 4.6))
for row, sbr in zip(axes, results.sbr.values, strict=True):
    row[0].imshow(ps.to_srgb(truth, 1))
    row[0].set_ylabel(f"SBR {sbr:g}")
    for ax, name in zip(row[1:], methods, strict=True):
        cell = results.sel(algorithm=name, sbr=sbr)
        image = cell.reconstruction.values
        ax.imshow(ps.to_srgb(ps.gain_matched(image, truth), 1))
        ax.set_xlabel(f"{float(cell.psnr):.1f} dB")
for ax, name in zip(axes[0], ("hidden", *methods), strict=True):
    ax.set_title(name)
for ax in axes.flat:
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)

# %%
# This method's weight is not tuned, and it models neither edges nor positive light. Change
# ``weight`` and run the page again.

print(results.psnr.to_series().unstack().round(1))
