"""
A first reconstruction
======================

A camera photographs a blank wall. Around the corner a monitor shows an image, a chair stands
between, and the sky outside lights the wall as well, twice as much as the monitor does. From that
one photograph the image comes back.
"""

# %%
# The scene
# ---------
# A scene is a Mitsuba file that keeps three ids: ``wall``, ``monitor`` and ``camera``. Everything
# else stands in the light's way. ``hidden`` says into how many patches the monitor is divided.

import numpy as np

import periscopy_sim as ps

hidden = (15, 18)
scene = ps.load_scenario("chair", hidden, {"resolution": 63})

# %%
# The light transport matrix :math:`A` says how each patch lights each pixel, the columns of
# :math:`B` how far lamps would.

A = ps.transport(scene)
B = ps.point_light_backgrounds(scene)
print(A.shape, B.shape)

# %%
# The photograph
# --------------
# It is path traced, with all bounces: it does not come from :math:`A`. The sky is one of ten
# places that ship. ``sbr`` is the monitor's light over the sky's, ``snr`` in dB what noise leaves.

truth = ps.read_hidden_image(ps.find_image("mushroom"), hidden)
signal = ps.render_photograph(scene, truth, samples=2304)
sky = ps.render_background("ambient/overcast", scene, target=3e-3).photograph
photograph = ps.add_noise(ps.composite(signal, sky, sbr=0.5), snr=60, seed=0)

# %%
# The image
# ---------
# A method is fitted to the scene once, and then takes any photograph of it.

method = ps.NoiseAware.for_scene(scene, A, B)
found = method.solve(photograph)
score = ps.psnr_gain_matched(found.image, truth)
ps.show(
    photograph,
    ps.gain_matched(found.image, truth),
    truth,
    titles=["the wall", f"found: {score:.1f} dB", "hidden"],
)
assert score > 22

# %%
# Does the scene explain the photograph? That can be asked without knowing the truth: what is left
# over should be noise.

residual = method.residual(photograph, found)
print(f"unexplained: {100 * residual.unexplained:.2f} % of the photograph")
print(f"noise alone would leave {100 * residual.noise_alone:.2f} %")
assert residual.unexplained < 2 * residual.noise_alone

# %%
# And how sure is each patch? The method tells a standard error, which goes up where the chair
# shows little of the image.

errors = method.standard_errors(found)
print(
    f"standard errors: {100 * np.median(errors) / found.image.max():.1f} % of white at the median"
)
