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

hidden = (15, 18)
scene = ps.load_scenario("chair", hidden, {"resolution": 63})

# %%
# The light transport matrix :math:`A` has the light of each patch in each pixel, :math:`B` the
# light of far lamps.

A = ps.transport(scene)
B = ps.point_light_backgrounds(scene)
print(A.shape, B.shape)

# %%
# The photograph
# --------------
# The photograph has finer shadows than :math:`A`, and light that bounces. The sky is one of ten
# places that ship. ``sbr`` is the monitor's light over the sky's, ``snr`` the photograph over its
# noise, in dB.

truth = ps.read_hidden_image(ps.find_image("mushroom"), hidden)
signal = ps.render_photograph(scene, truth)
sky = ps.render_background("ambient/overcast", scene, target=3e-3).photograph
photograph = ps.add_noise(ps.composite(signal, sky, sbr=0.5), snr=60, seed=0)

# %%
# The image
# ---------
# Fit a method to the scene once. It then accepts any photograph of the scene.

method = ps.NoiseAware.for_scene(scene, A, B)
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

residual = method.residual(photograph, solution)
print(f"unexplained: {100 * residual.unexplained:.2f} % of the photograph")
print(f"noise alone would leave {100 * residual.noise_alone:.2f} %")
assert residual.unexplained < 2 * residual.noise_alone

# %%
# The method reports a standard error for each patch, which is larger where the chair shows little
# of the image.

errors = method.standard_errors(solution)
median = 100 * np.median(errors) / solution.image.max()
print(f"standard errors: {median:.1f} % of white at the median")
