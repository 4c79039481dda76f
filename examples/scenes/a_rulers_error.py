"""
A wrong ruler, and what calibration corrects
============================================

The chair stands 4 mm to the right of its measured place. This error spoils the picture, and the
photograph shows it: no image explains the photograph unless the chair moves.
"""

import matplotlib.pyplot as plt
import numpy as np

import periscopy_sim as ps

scene = ps.load_scenario("chair", (10, 12), {"resolution": 48})  # as measured
true_values = {"occluder_dx": 0.004}
true_scene = scene.at(**true_values)
truth = true_scene.image("mushroom")
signal = true_scene.photograph(truth, bounces=1).values
lamp = ps.point_light_backgrounds(true_scene, np.array([[-1.2, 1.9, 0.4]])).reshape(48, 48, 1)
photograph = ps.add_noise(ps.composite(signal, lamp + 0 * signal, sbr=3), snr=60, seed=0)

# %%
# One number is free, measured to half a centimetre. ``calibrate`` knows neither the image nor
# the lamp; it combines the photograph with the measured value.

calibration = scene.calibrate(photograph, free={"occluder_dx": 0.005})
for parameter in calibration.parameters:
    name = parameter.name
    print(
        f"{name}: measured 0.0 mm, calibrated {1e3 * parameter.value:+.2f} ± "
        f"{1e3 * parameter.standard_error:.2f} mm, true {1e3 * true_values[name]:+.1f} mm"
    )
    assert abs(parameter.value - true_values[name]) < 0.0015

# %%
# The same photograph, reconstructed with the measured, the calibrated and the true scene:


def reconstructed(scene):
    method = scene.method("noise-aware", photograph)
    solution = method.solve(photograph)
    return solution.image, method.residual(photograph, solution)


results = {
    "measured": reconstructed(scene),
    "calibrated": reconstructed(calibration.scenario),
    "true scene": reconstructed(true_scene),
}
figure, axes = plt.subplots(2, 4, figsize=(6, 3.5))
axes[0, 0].imshow(ps.to_srgb(truth, 1))
axes[0, 0].set_title("hidden image")
axes[1, 0].imshow(ps.to_srgb(photograph))
axes[1, 0].set_title("photograph")
for (above, below), (name, (image, residual)) in zip(axes.T[1:], results.items(), strict=True):
    above.imshow(ps.to_srgb(ps.gain_matched(image, truth), 1))
    above.set_title(f"{name}\n{ps.psnr_gain_matched(image, truth):.1f} dB")
    percent = 100 * residual.light.mean(axis=2) / np.sqrt(np.mean(photograph**2))
    below.imshow(percent, cmap="RdBu_r", vmin=-1, vmax=1)
    below.set_title(f"unexplained:\n{100 * residual.unexplained:.2f} %")
for ax in axes.flat:
    ax.set_axis_off()

before, after, best = (ps.psnr_gain_matched(image, truth) for image, _ in results.values())
assert after > before + 1 and after > best - 2
