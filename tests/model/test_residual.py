"""What scene and image leave of a photograph, and what it may be."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.reconstruction.residual.causes import Cause, advice_for
from periscopy_sim.reconstruction.residual.structure import Structure
from scipy import ndimage

from periscopy_sim.model.residual import Residual, residual_of
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.storage.formats.srgb import srgb_decode, srgb_encode

SHAPE, HIDDEN = (40, 44), (4, 5)
V, U = np.meshgrid(*(np.linspace(-1, 1, size) for size in SHAPE), indexing="ij")
SCENE = SimpleNamespace(
    photograph_shape=SHAPE, hidden_shape=HIDDEN, channel_gain=np.array([1.2, 1, 0.8])
)
RNG = np.random.default_rng(4)
TRUTH = np.random.default_rng(7).uniform(0.3, 1, (20, 3))
SNR = 2e-3


def transport(shift=0.0):
    """Columns of A: falling light, and the soft shadow of a block, elsewhere for each patch."""
    columns = []
    for i in range(HIDDEN[0]):
        for j in range(HIDDEN[1]):
            u, v = U - 0.2 * (j - 2) - shift, V - 0.2 * (i - 1.5)
            edge = lambda t: 1 / (1 + np.exp(-9 * t))  # noqa: E731
            shadow = 1 - edge(u + 0.3) * edge(0.3 - u) * edge(v + 0.4)
            columns.append(shadow / (1 + 0.3 * (U - 0.1 * j) ** 2 + 0.3 * (V - 0.1 * i) ** 2))
    return np.array(columns).reshape(20, -1).T


A = transport()
B = np.stack([np.ones(V.size), U.ravel(), V.ravel(), (U * V).ravel(), (U**2).ravel()], axis=1)


def paint(scale, seed=0):
    field = np.random.default_rng(seed).standard_normal(SHAPE)
    smooth = ndimage.gaussian_filter(field, scale, mode="wrap") if scale else field
    return (smooth / smooth.std())[..., None]


def photograph(A=A, wall=0.0, noise=SNR, seed=0):
    light = (A @ TRUTH + 8 * B[:, :1] + B[:, 1:2]).reshape(*SHAPE, 3) * (1 + wall)
    draw = np.random.default_rng(seed).standard_normal(light.shape)
    return (light + noise * np.sqrt(np.mean(light**2)) * draw) * SCENE.channel_gain


def residual(y, name="noise-aware", mask=None, **options):
    method = METHODS[name](SCENE, A, B, mask, **options)
    found = method.solve(y)
    return method.residual(y, found), found


KNOW_LIGHT = ("noise-aware", "preconditioned", "iterative")


@pytest.mark.thorough
@pytest.mark.parametrize("name", [name for name, entry in METHODS.items() if not entry.needs])
@pytest.mark.parametrize("masked", [False, True])
def test_residual_is_the_photograph_less_image_and_ambient_light(name, masked):
    mask = (V < 0.5) | (U > 0) if masked else None
    y = photograph()
    left, found = residual(y, name, mask)
    used = np.ones(SHAPE, bool) if mask is None else mask
    rest = y / SCENE.channel_gain - (A @ found.image.reshape(-1, 3)).reshape(*SHAPE, 3)
    rest = rest[used]
    knows_no_light = name in ("truncated-svd", "pseudoinverse")
    if not knows_no_light:
        Q = np.linalg.qr(B[used.ravel()])[0]
        rest -= Q @ (Q.T @ rest)
    np.testing.assert_allclose(left.light[used], rest, atol=1e-5 * y.max())
    assert np.isnan(left.light[~used]).all()
    grey = (y / SCENE.channel_gain)[used]
    freedom = len(rest) - (0 if knows_no_light else B.shape[1])
    expected = np.sqrt(np.sum(rest**2) / (3 * freedom) / np.mean(grey**2))
    assert left.unexplained == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", KNOW_LIGHT)
def test_unexplained_is_noise_alone_where_the_scene_is_right(name):
    # Of so few patches, its total variation and repair take details for noise.
    weights = {"repair_threshold": 1e9, "tv_weight": 0.01}
    options = weights if name == "preconditioned" else {}
    left, _ = residual(photograph(), name, **options)
    assert left.noise_alone == pytest.approx(SNR, rel=0.1)
    assert left.unexplained < 1.25 * SNR
    assert left.warning == "" and left.causes == ()
    assert left.remark == (
        f"unexplained: {100 * left.unexplained:.2f} % of the photograph; noise alone would leave "
        f"{100 * left.noise_alone:.2f} %"
    )


@pytest.mark.parametrize("name", KNOW_LIGHT)
def test_unit_of_the_photograph_does_not_matter(name):
    y = photograph()
    one, other = (residual(unit * y, name)[0] for unit in (1, 1e9))
    assert other.unexplained == pytest.approx(one.unexplained, rel=1e-3)
    assert other.noise_alone == pytest.approx(one.noise_alone, rel=1e-6)


@pytest.mark.parametrize("name", ["noise-aware", "preconditioned"])
@pytest.mark.parametrize("left_out", [None, V < -0.95, V < -0.2])
def test_a_photograph_that_is_upside_down_is_named_one_that_is_not_is_not(name, left_out):
    mask = None if left_out is None else ~left_out
    left = residual(photograph()[::-1], name, mask)[0]
    is_told = left_out is None or left_out.mean() < 0.05
    assert (left.better_orientation == "mirrored top to bottom") == is_told
    assert ("or the photograph came mirrored top to bottom" in left.warning) == is_told
    assert left.told()["better_orientation"] == left.better_orientation
    wrong = residual(photograph(transport(0.12)), name, mask)[0]
    assert wrong.causes and wrong.better_orientation == "" and "mirrored" not in wrong.warning


@pytest.mark.parametrize("level", [0.2, 0.9])
def test_a_photograph_that_is_encoded_for_screens_is_named_one_that_is_not_is_not(level):
    y = np.maximum(photograph(), 0)
    # Of so few patches, the noise-aware method takes the curve for an uneven wall.
    encoded = residual(srgb_encode(level * y / y.max()), "preconditioned")[0]
    assert encoded.better_encoding.startswith("is encoded for screens")
    assert "if the photograph is encoded for screens" in encoded.warning
    assert encoded.told()["better_encoding"] == encoded.better_encoding
    for name in ("noise-aware", "preconditioned"):
        decoded = residual(srgb_decode(level * y / y.max()), name)[0]
        assert decoded.better_encoding.startswith("was linear before")
        wrong = residual(photograph(transport(0.12)), name)[0]
        assert wrong.causes and wrong.better_encoding == "" and "sRGB" not in wrong.warning


def test_right_scenes_are_rarely_warned_of():
    method = METHODS["noise-aware"](SCENE, A, B)
    told = []
    for seed in range(40):
        y = photograph(noise=5e-3, seed=seed)
        told.append(method.residual(y, method.solve(y)).warning)
    assert not any(told)


SPOTS = np.zeros((*SHAPE, 1))
SPOTS[RNG.integers(0, 40, 8), RNG.integers(0, 44, 8)] = 0.2

POSTER = np.zeros((*SHAPE, 1))
POSTER[6:14, 31:39] = np.random.default_rng(8).uniform(-0.5, 0.1, (8, 8, 1))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("y", "cause", "advice"),
    [
        (photograph(wall=0.01 * paint(1.2)), "paint", "--background"),
        (photograph(wall=0.01 * paint(0)), "paint", "--background"),
        (photograph(transport(0.12)), "geometry", "periscopy calibrate"),
        (photograph(wall=SPOTS), "pixels", "--mask"),
        (photograph(wall=POSTER), "object", "in rows 5 to 14, columns 30 to 39 (--mask)"),
        (
            photograph(noise=0)
            + ndimage.uniform_filter(
                np.random.default_rng(0).standard_normal((*SHAPE, 3)), (2, 2, 0)
            ),
            "shared noise",
            "neighbouring pixels share",
        ),
    ],
)
def test_likeliest_cause_comes_first(y, cause, advice):
    left, _ = residual(y)
    assert left.causes[0].name == cause, left.causes
    assert advice in left.warning and "\n" not in left.warning
    assert left.unexplained > left.noise_alone
    assert left.told()["likely_causes"][cause] == left.causes[0].share


def test_image_that_was_smoothed_too_far_is_no_fault_of_the_scene():
    left, _ = residual(photograph(), "preconditioned")
    assert left.unexplained > 3 * left.noise_alone and left.warning == ""
    left, _ = residual(photograph(transport(0.12)), "preconditioned")
    assert left.causes[0].name == "geometry"


def test_paint_of_one_pixel_is_not_called_noise():
    left, _ = residual(photograph(wall=0.01 * paint(0)))
    assert left.unexplained > 3 * left.noise_alone
    assert left.noise_alone == pytest.approx(SNR, rel=0.5)


def test_photograph_without_noise_or_without_rows_is_no_error():
    left, _ = residual(np.zeros((*SHAPE, 3)))
    assert left.unexplained == 0 and left.warning == ""
    method = METHODS["noise-aware"].__call__(SCENE, A, B)
    flat = type(method)(A, B, hidden_shape=HIDDEN)
    y = photograph().reshape(-1, 3)
    assert flat.residual(y, flat.solve(y)) is None


@pytest.mark.thorough
@pytest.mark.parametrize("size", [1, 3])
def test_paint_and_shadows_are_nothing_that_hangs_on_the_wall(size):
    for seed in range(10):
        wrong = (
            photograph(wall=0.01 * paint(size, seed), seed=seed),
            photograph(transport(0.1 + 0.02 * seed), seed=seed),
        )
        for y in wrong:
            left, _ = residual(y)
            assert "object" not in [cause.name for cause in left.causes]


def test_causes_depend_on_whether_the_monitor_was_photographed_off():
    for y in (photograph(wall=0.01 * paint(1.2)), photograph(transport(0.12))):
        left, _ = residual(y)
        beside = replace(left, has_backgrounds=True).warning
        assert "--background" not in beside and "uneven paint" not in beside
        assert "periscopy calibrate" in beside
    both = [Cause("paint", 0.9), Cause("geometry", 0.4), Cause("smooth light", 0.2)]
    alone = advice_for(both, has_backgrounds=False).split("; ")
    beside = advice_for(both, has_backgrounds=True)
    assert alone[0].startswith("uneven paint") and alone[1].startswith("a scene that is off")
    assert beside.startswith("a scene that is off") and "--flat" in beside
    assert beside.count("a scene that is off") == 1
    assert "a scene that is off" in advice_for(both[:1], has_backgrounds=True)


@pytest.mark.parametrize("has_backgrounds", [False, True])
def test_a_calibrated_scene_is_not_to_be_calibrated(has_backgrounds):
    left, _ = residual(photograph(transport(0.12)))
    again = replace(left, has_backgrounds=has_backgrounds, is_calibrated=True).warning
    assert "a scene that is off" in again
    assert again.count("periscopy calibrate") == again.count("calibrate with more numbers") == 1


@pytest.mark.parametrize(
    ("unexplained", "alone", "told"),
    [
        (
            0.0034,
            0.0011,
            "leaves 0.34 % of the photograph / 0.11 %",
        ),
        (
            0.00122,
            0.00118,
            "leaves 0.122 % of the photograph / 0.118 %",
        ),
        (0.001201, 0.001199, "0.1201 % of the photograph / 0.1199 %"),
        (0.0011, 0.0012, "the scene leaves 0.11 % of the photograph unexplained; blurred by a Ga"),
    ],
)
def test_two_numbers_are_told_by_the_digits_in_which_they_differ(unexplained, alone, told):
    smooth = Structure(1e-9, 4.0, 1.84, 0.5, True, 0.0)
    causes = (Cause("smooth light", 1.0),)
    left = Residual(np.zeros((*SHAPE, 3)), unexplained, alone, None, smooth, causes)
    assert told in left.warning.replace("unexplained, where noise alone would leave", "/")
    assert "of 4 px it has 1.8 times the energy of noise" in left.warning


def test_causes_are_named_where_images_explain_much_of_the_noise():
    """What is left of the noise, not all of it, is what a structure stands out of."""
    rng = np.random.default_rng(3)
    pixels = V.size
    A = rng.random((pixels, 700))  # 40 % of white noise
    transport = TransportOperator(A, np.ones((pixels, 1)) / np.sqrt(pixels))
    signal = np.repeat(A.mean(axis=1, keepdims=True), 3, axis=1)
    light = 10 + signal
    noise = rng.standard_normal((pixels, 3))

    def place(values):
        return values.T.reshape(-1, *SHAPE)

    for strength, likeliest in ((0.0, ""), (0.055, "paint")):
        uneven = light * strength * paint(2).reshape(-1, 1)
        left = residual_of(light + uneven + noise, signal, transport, place)
        assert np.nansum(left.light**2) < 1.4 * noise.size  # of noise alone 1
        assert left.likeliest == likeliest
    assert sum(cause.share for cause in left.causes) == pytest.approx(1, abs=0.15)
