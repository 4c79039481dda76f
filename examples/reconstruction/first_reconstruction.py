"""
A first reconstruction
======================

A camera photographs a blank wall. Around the corner a monitor shows an image, a chair stands
between, and the sky lights the wall twice as much as the monitor does. This script recovers the
image from that one photograph.
"""

# %%
# The scene
# ---------
# A scene is a Mitsuba file that keeps three ids: ``wall``, ``monitor`` and ``camera``. Every other
# shape is an occluder. ``hidden`` is the number of the monitor's patches, rows first.

import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("chair", hidden=(15, 18), parameters={"resolution": 63})

# %%
# The light transport matrix :math:`A` has the light of each patch in each pixel, :math:`B` the
# light of far lamps.

print(scene.A.shape, scene.B.shape)

# %%
# The photograph
# --------------
# The photograph has finer shadows than :math:`A`, and light that bounces. The sky is one of ten
# places that ship. ``sbr`` is the monitor's light over the sky's, ``snr`` the photograph over its
# noise, in dB.

truth = scene.image("mushroom")
photograph = scene.photograph(truth, ambient="overcast", sbr=0.5, snr=60, target=3e-3)

# %%
# The image
# ---------
# A method is fitted to the scene once, for photographs of this noise. It then accepts any of them.

method = scene.method("noise-aware", photograph)
solution = method.solve(photograph)
score = ps.psnr_gain_matched(solution.image, truth)
ps.show(
    photograph,
    ps.gain_matched(solution.image, truth),
    truth,
    titles=["photograph", f"reconstruction: {score:.1f} dB", "hidden image"],
)
assert score > 22

# %%
# Does the scene explain the photograph? Then the residual is noise, which needs no truth to check.

report = scene.judge(photograph, solution, method)
print(f"unexplained: {100 * report.residual.unexplained:.2f} % of the photograph")
print(f"noise alone would leave {100 * report.residual.noise_alone:.2f} %")
assert report.verdict.code == "fits"

# %%
# The method reports a standard error for each patch, which is larger where the chair shows little
# of the image. The errors of the scene that its file declares count, too.

median = 100 * np.median(report.standard_errors) / solution.image.max()
print(f"standard errors: {median:.1f} % of white at the median")
