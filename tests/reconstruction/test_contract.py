"""What every method of the registry must be and do with a photograph, and every video with frames.

Photographs carry their mask, their photographs with the monitor off and what else belongs to them;
nothing of these is a keyword here. A new method is included by its entry in `METHODS`.
"""

import inspect
import pickle
from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import aslinearoperator

from periscopy_sim.photograph import ColourMatrix, Photograph
from periscopy_sim.reconstruction.method import FrameByFrame, StillMethod
from periscopy_sim.reconstruction.noise_aware import NoiseAware
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS, MethodEntry, Option

SHAPE, HIDDEN = (14, 15), (4, 5)
M, N = 210, 20
RNG = np.random.default_rng(4)
V, U = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE)))
PATTERNS = [np.linalg.qr(RNG.standard_normal((size, N)))[0] for size in (M, N)]
A = (PATTERNS[0] * np.geomspace(1, 3e-2, N)) @ PATTERNS[1].T + 0.5
B = np.stack([np.ones(M), U, V], axis=1)
TRUTH = RNG.uniform(0.2, 1, (N, 3))
GAIN = np.array([1.2, 1.0, 0.8])
LAMP = RNG.uniform(0.5, 1.5, (M, 3))  # of no point light
NOISE = 3e-3 * RNG.standard_normal((M, 3))
AMBIENT = B @ np.array([[0.9], [0.1], [0.2]])
Y = ((A @ TRUTH + AMBIENT + NOISE) * GAIN).reshape(*SHAPE, 3)
LIT = Y + (LAMP * GAIN * [2, 1, 3]).reshape(Y.shape)
OFF = (LAMP * GAIN).reshape(Y.shape)
MASK, OTHER = RNG.random((2, *SHAPE)) > 0.2
MASK[5:8, 2:6] = False
COLOURS = np.array([[0.7, 0.25, 0.05], [0.2, 1.0, 0.3], [0.0, 0.3, 1.2]])

VIDEOS = [name for name in METHODS if METHODS[name].video]
COUPLED = [(name, coupling) for name in VIDEOS for coupling in METHODS[name].video.couplings]
NEIGHBOURS = ("differencing",)  # which needs a photograph's rows and columns
every_method = pytest.mark.parametrize("name", METHODS)
one_of_each_base = pytest.mark.parametrize("name", ["noise-aware", "truncated-svd"])


@dataclass(frozen=True)
class Scene:
    channel_gain: tuple = tuple(GAIN)
    photograph_shape: tuple | None = SHAPE
    hidden: tuple = HIDDEN


def fitted(name, A=A, B=B, scene=Scene(), **options):
    """Return a method without what knows of all channels, or of rows and columns of pixels."""
    entry = METHODS[name]
    if any(option.name == "repair_threshold" for option in entry.options):
        options = {"repair_threshold": 1e9, **options}
    if name == "noise-aware":
        return NoiseAware.for_scene(scene, A, B, profiles=False, corrections=(), **options)
    return entry(scene, A, B, **options)


def as_chosen(name):
    """Return a method as commands fit it."""
    return METHODS[name](Scene(), A, B)


def distance(image, expected):
    return np.linalg.norm(image - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize("name", METHODS)
def test_options_have_the_defaults_of_the_class_within_their_bounds(name):
    entry = METHODS[name]
    assert entry.name == name and DEFAULT in METHODS and len(METHODS) > 4
    kinds = [(entry, StillMethod), *([(entry.video, FrameByFrame)] if entry.video else [])]
    for each, base in kinds:
        module, _, kind = each.of.partition(":")
        made = getattr(import_module(f"periscopy_sim.reconstruction.{module}"), kind)
        assert issubclass(made, base)
        parameters = {}  # of the base, too: `rank_tolerance`
        for part in reversed(made.__mro__[:-1]):
            parameters |= inspect.signature(part.__init__).parameters
        for option in each.options:
            assert parameters[option.parameter or option.name].default == option.default
            assert option.least <= option.default <= option.most and option.help
            assert option.coupling in ("", *(entry.video.couplings if entry.video else ()))


@every_method
def test_options_reach_their_parameters_from_the_least_to_the_most(name):
    for option in METHODS[name].options:
        for value in (option.least, (option.default + option.most) / 2, option.most):
            method = METHODS[name](Scene(), A, B, **{option.name: value})
            if option.name != "rank_tolerance":  # not kept
                assert getattr(method, option.parameter or option.name) == value
        for wrong in (-1, np.nan, *([0] if option.least else [])):
            with pytest.raises(ValueError):
                method = METHODS[name](Scene(), A, B, **{option.name: wrong})
                assert option.name == "rank_tolerance"  # every other at once
                method.reconstruct(Y)
    with pytest.raises(KeyError):
        METHODS[name](Scene(), A, B, unknown=1.0)


def test_a_new_method_is_one_entry():
    option = Option("fraction", 0.4, "Part of the singular values that are kept.", 0.01, 1)
    entry = MethodEntry("mine", "mine", "truncated_svd:TruncatedSVD", (option,))
    assert entry(Scene(), A, B, fraction=0.5).fraction == 0.5


@every_method
def test_a_photograph_becomes_an_image_and_a_report(name):
    method = as_chosen(name)
    solution = method.solve(Photograph.of(Y))
    assert solution.image.shape == (*HIDDEN, 3) and solution.image.dtype == method.precision
    assert np.isfinite(solution.image).all()
    for same in (Photograph.of(Y), Y, Y.reshape(M, 3)):
        np.testing.assert_array_equal(method.reconstruct(same), solution.image)
    report = method.report(Photograph.of(Y), solution)
    assert (report.standard_errors is not None) == bool(METHODS[name].certainty)
    assert report.standard_errors is None or report.standard_errors.shape == (*HIDDEN, 3)
    assert all(image.shape == (*HIDDEN, 3) for _, image in report.stages)
    assert {"noise", "lambda"} <= report.numbers.keys()
    assert all(note.code.isidentifier() for note in (*report.notes, *report.warnings))
    assert repr(method) == f"{type(method).__name__}(4x5 patches, 14x15 pixels)"
    assert repr(solution).startswith(f"{type(solution).__name__}(4x5, noise ")
    assert len(repr(solution)) < 100 and "array" not in repr(solution)


@every_method
@pytest.mark.parametrize("exposure", [1e-12, 1e12])
def test_exposure_scales_the_image_the_noise_and_nothing_else(name, exposure):
    method = fitted(name)
    one, other = method.solve(Y), method.solve(Photograph.of(exposure * Y))
    assert distance(other.image / exposure, one.image) < 3e-4
    np.testing.assert_allclose(other.noise, exposure * np.asarray(one.noise), rtol=1e-3)


@every_method
@pytest.mark.parametrize("seed", range(2))
def test_units_and_orders_do_not_matter(name, seed):
    """Of A, of B, of its columns, of the channels and, but for neighbours, of the pixels."""
    rng = np.random.default_rng(seed)
    channels, columns = rng.permutation(3), rng.permutation(3)
    pixels = np.arange(M) if name in NEIGHBOURS else rng.permutation(M)
    unit, ambient = rng.choice([1e-6, 0.3, 1e12], 2)
    plain = Scene(photograph_shape=SHAPE if name in NEIGHBOURS else None)
    scene = replace(plain, channel_gain=tuple(GAIN[channels]))
    turned = np.asarray(unit * A[pixels], order=rng.choice(["C", "F"]))
    other = fitted(name, turned, ambient * B[pixels][:, columns], scene)
    y = Y.reshape(M, 3)[pixels][:, channels]
    image = unit * other.reconstruct(y)[..., np.argsort(channels)]
    assert distance(image, fitted(name, scene=plain).reconstruct(Y)) < 3e-4


@pytest.mark.parametrize("name", ["noise-aware", "preconditioned"])
def test_prototype_backgrounds_of_any_strength_leave_the_image_alone(name):
    method, light = METHODS[name](Scene(), A, B), 1e3 * B @ RNG.random((3, 3)) * GAIN
    lit = method.reconstruct(Y + light.reshape(Y.shape))
    assert distance(lit, method.reconstruct(Y)) < 1e-3


@every_method
def test_the_walls_colour_is_divided_out(name):
    white = fitted(name, scene=Scene((1.0, 1.0, 1.0)))
    image = white.reconstruct(Y / GAIN)
    assert distance(fitted(name).reconstruct(Y), image) < 1e-5


@every_method
def test_a_constant_channel_disturbs_no_other(name):
    """Not by more than the coupling of edges; its own image is finite."""
    method, y = fitted(name), Y.copy()
    y[..., 2] = 5
    image = method.reconstruct(y)
    assert np.isfinite(image).all()
    assert distance(image[..., :2], method.reconstruct(Y)[..., :2]) < 0.05


def spread(y):
    within = np.full((2 * y.shape[0], 3 * y.shape[1], 6), np.nan)
    within[::2, ::3, ::2] = y
    return within[::2, ::3, ::2]


KINDS = {
    "float32": lambda y: y.astype(np.float32),
    "big-endian": lambda y: y.astype(">f8"),
    "8 bits": lambda y: (100 * y / y.max()).astype(np.uint8),
    "16 bits": lambda y: (60_000 * y / y.max()).astype(">u2"),
    "truth values": lambda y: y > np.median(y),
    "not contiguous": spread,
    "not aligned": lambda y: np.ndarray(y.shape, y.dtype, bytearray(b"\0" + y.tobytes()), 1),
    "nested lists": lambda y: y.tolist(),
}


@pytest.mark.filterwarnings("ignore:the photograph is of 8-bit integers")
@pytest.mark.filterwarnings("ignore:.* stopped after:RuntimeWarning")
@one_of_each_base
def test_every_kind_of_array_gives_the_image_of_its_values(name):
    method = fitted(name, A.astype(np.float32))
    for kind, made in KINDS.items():
        given = made(Y)
        expected = method.reconstruct(np.array(given, np.float64, order="C"))
        image = method.reconstruct(given)
        assert image.dtype == expected.dtype, kind
        error = np.abs(image - expected).max()
        assert error <= 1e-5 * np.abs(expected).max(), kind


def hot(y):
    y = 0 * y
    y[3, 4, 1] = 1e6
    return y


EXTREMES = {
    "constant": np.ones_like,
    "one hot value": hot,
    "a hot pixel in light": lambda y: y + hot(y),
    "saturated": lambda y: np.minimum(y, np.quantile(y, 0.2)),
    "dark": np.zeros_like,
    "negative": lambda y: -y,
    "of 2 levels": lambda y: np.round(y / y.max()),
}


@pytest.mark.filterwarnings("ignore:.* stopped after:RuntimeWarning")
@every_method
def test_extreme_photographs_give_finite_images(name):
    method = fitted(name)
    for kind, made in EXTREMES.items():
        assert np.isfinite(method.reconstruct(made(Y))).all(), kind


@every_method
def test_what_lies_outside_the_mask_is_not_used(name):
    method = fitted(name)
    garbage = np.resize([1e30, np.nan, -np.inf, np.inf, -1e300, 0.0, 7.0], Y.shape)
    clean, spoilt = (
        Photograph.of(each, mask=MASK, monitor_off={"off": off})
        for each, off in (
            (LIT, OFF),
            (np.where(MASK[..., None], LIT, garbage), np.where(MASK[..., None], OFF, np.nan)),
        )
    )
    solution = method.solve(clean)
    assert np.isfinite(solution.image).all()
    np.testing.assert_array_equal(method.reconstruct(spoilt), solution.image)
    used = MASK.ravel()[:, None]  # nor are the other rows of A and B
    again = fitted(name, np.where(used, A, np.nan), np.where(used, B, np.inf))
    np.testing.assert_array_equal(again.reconstruct(spoilt), solution.image)
    assert np.isnan(method.residual(clean, solution).light[~MASK]).all()
    numbers = [method.report(each, solution).numbers for each in (clean, spoilt)]
    np.testing.assert_equal(*numbers)
    assert np.abs(solution.image - method.reconstruct(LIT)).max() > 1e-4
    assert method.fitted_to(clean) is method.fitted_to(clean)


@pytest.mark.parametrize("name", [name for name in METHODS if name not in NEIGHBOURS])
def test_a_mask_is_as_a_matrix_of_the_pixels_used_and_a_monitor_off_as_columns_of_b(name):
    used, flat = MASK.ravel(), Scene(photograph_shape=None)
    image = fitted(name, scene=flat).reconstruct(Photograph.of(Y, mask=MASK))
    by_hand = fitted(name, A[used], B[used], flat).reconstruct(Y[MASK])
    np.testing.assert_allclose(image, by_hand, rtol=1e-5, atol=1e-6)
    if name not in ("truncated-svd", "pseudoinverse"):  # they use no B
        dark = fitted(name, scene=flat).reconstruct(
            Photograph.of(LIT, mask=MASK, monitor_off=[OFF])
        )
        by_hand = fitted(name, A[used], np.hstack([B, LAMP])[used], flat).reconstruct(LIT[MASK])
        np.testing.assert_allclose(dark, by_hand, rtol=1e-4, atol=1e-4)


@every_method
def test_photographs_with_the_monitor_off_recover_what_their_light_drowns(name):
    """Whatever their exposure and their order, and of two photographs as of each."""
    method, truth = fitted(name), TRUTH.reshape(*HIDDEN, 3)
    flipped = OFF[::-1]
    one = method.reconstruct(Photograph.of(LIT, monitor_off={"lamp": OFF, "other": flipped}))
    again = {"b": 1e3 * flipped, "a": np.float32(OFF)}
    np.testing.assert_allclose(
        method.reconstruct(Photograph.of(LIT, monitor_off=again)), one, rtol=2e-4, atol=2e-4
    )
    helped = method.reconstruct(Photograph.of(LIT, monitor_off=[OFF]))
    assert distance(helped, truth) < 0.6 * distance(method.reconstruct(LIT), truth)


@every_method
def test_an_image_is_in_the_monitors_primaries_whatever_the_camera(name):
    colours, y = ColourMatrix(COLOURS), Y.copy()
    plain = as_chosen(name)
    expected = plain.solve(Photograph.of(y, monitor_off={"off": OFF}))
    off = {"off": colours.mix(OFF)}
    mixed = Photograph.of(colours.mix(y), monitor_off=off, colour_matrix=colours)
    method = as_chosen(name)
    solution = method.solve(mixed)
    assert distance(solution.image, expected.image) < 0.05
    residuals = [
        method.report(mixed, solution).residual,
        plain.report(Photograph.of(y, monitor_off={"off": OFF}), expected).residual,
    ]
    assert residuals[0].unexplained == pytest.approx(residuals[1].unexplained, rel=0.5)


@every_method
@pytest.mark.parametrize("channels", [1, 4])
def test_an_image_has_the_channels_of_the_photograph(name, channels):
    method = fitted(name, scene=Scene(channel_gain=None))
    y = (Y / GAIN)[..., [1, 0, 2, 1][:channels]]
    image = method.reconstruct(y)
    assert image.shape == (*HIDDEN, channels)
    if channels == 1:  # also on a coloured wall, and as two channels alike
        np.testing.assert_array_equal(fitted(name).reconstruct(y), image)
        twice = method.reconstruct(np.repeat(y, 2, axis=2))
        assert distance(twice, np.repeat(image, 2, axis=2)) < 0.02


@every_method
@pytest.mark.parametrize("mask", [None, MASK], ids=["whole", "masked"])
def test_residual_is_the_photograph_less_image_and_ambient_light(name, mask):
    method, photograph = as_chosen(name), Photograph.of(Y, mask=mask)
    solution = method.solve(photograph)
    residual = method.report(photograph, solution).residual
    used = np.ones(SHAPE, bool) if mask is None else mask
    grey = Y / GAIN
    rest = (grey - (A @ solution.image.reshape(-1, 3)).reshape(Y.shape))[used]
    grey, freedom = grey[used], len(rest)
    if name == "noise-aware":  # its ambient light has profiles, too
        fit = method.fitted_to(photograph).fit
        rest, freedom = fit.project_out(rest.T).T, freedom - len(fit.background)
    elif name not in ("truncated-svd", "pseudoinverse"):
        Q = np.linalg.qr(B[used.ravel()])[0]
        rest, freedom = rest - Q @ (Q.T @ rest), freedom - B.shape[1]
    np.testing.assert_allclose(residual.light[used], rest, atol=1e-5 * Y.max())
    expected = np.sqrt(np.sum(rest**2) / (3 * freedom) / np.mean(grey**2))
    assert residual.unexplained == pytest.approx(expected, rel=1e-3)
    again = method.residual(photograph, solution)
    np.testing.assert_array_equal(again.light, residual.light)


@every_method
def test_what_cannot_be_used_is_rejected(name):
    method = METHODS[name](Scene(), A, B)
    for shape in ((15, 14, 3), (209, 3), (14, 15), (14, 15, 4), (3, 14, 15), (630,), ()):
        with pytest.raises(ValueError, match="photograph"):
            method.reconstruct(np.ones(shape))
    for wrong in (np.nan, np.inf, 1e300, 1e-300):
        y = np.where(np.arange(Y.size).reshape(Y.shape) == 77, wrong, Y if wrong > 1 else 0)
        with pytest.raises(ValueError, match=r"must be finite|largest value"):
            method.reconstruct(y)
    few = np.arange(M).reshape(SHAPE) < N - 1
    with pytest.raises(ValueError, match="pixels"):
        method.reconstruct(Photograph.of(Y, mask=few))
    with pytest.raises(TypeError, match=rf"to fit to a scene, {type(method).__name__}\.for_scene"):
        type(method)(Scene(), A, B)


NO_MATRICES = (
    sparse.csr_array, aslinearoperator, lambda X: X * (1 + 0j), lambda X: X.astype(object),
    lambda X: X.astype(str), lambda X: X > 0, lambda X: np.ma.masked_less(X, np.median(X)),
    lambda X: X[..., None], lambda X: X[:, 0], lambda X: [*X[:-1].tolist(), [1.0]], str,
)  # fmt: skip


@one_of_each_base
def test_what_is_no_matrix_is_refused_by_its_name(name):
    given = {"A": A, "B": B}
    for which in given if METHODS[name].backgrounds else "A":
        for kind in NO_MATRICES:
            with pytest.raises(ValueError, match=f"^{which} is of type .* shape .*: "):
                fitted(name, **given | {which: kind(given[which])})


@one_of_each_base
def test_matrices_of_other_libraries_are_taken(name):
    def read_only(X):
        X = X.astype(">f8")
        X.flags.writeable = False
        return X

    fine = np.rint(1e6 * A), np.rint(1e6 * B)
    expected = fitted(name, *fine).reconstruct(Y)
    for kind in (read_only, np.ndarray.tolist, np.asfortranarray, lambda X: X.astype(np.int64)):
        np.testing.assert_allclose(
            fitted(name, *map(kind, fine)).reconstruct(Y), expected, rtol=1e-6
        )


@every_method
def test_a_copy_gives_the_same_images(name):
    method = fitted(name)
    expected = method.reconstruct(Y)
    copy = pickle.loads(pickle.dumps(method))
    np.testing.assert_array_equal(copy.reconstruct(Photograph.of(Y)), expected)
    np.testing.assert_array_equal(method.reconstruct(Y), expected)
    masked = Photograph.of(Y, mask=MASK)
    np.testing.assert_allclose(copy.reconstruct(masked), method.reconstruct(masked), rtol=1e-6)


# -- videos --------------------------------------------------------------------------------------

FRAMES = np.stack([k * Y for k in (1, 0.9, 1.1, 1, 1.05)])


def video_of(name, coupling, **options):
    return METHODS[name].frames_by(METHODS[name](Scene(), A, B), coupling, **options)


@pytest.mark.parametrize(("name", "coupling"), COUPLED)
def test_first_frames_are_stills_and_batches_are_frames_one_at_a_time(name, coupling, monkeypatch):
    monkeypatch.setattr("periscopy_sim.reconstruction.method.BATCH", 2)
    live, batch = video_of(name, coupling), video_of(name, coupling)
    for y in (FRAMES[0], FRAMES[3]):
        live.restart()
        assert live.previous is None
        still = live.still.reconstruct(y)
        np.testing.assert_allclose(live.next_frame(y), still, rtol=1e-5)
        np.testing.assert_allclose(live.previous, still, rtol=1e-5)
    live.restart()
    one_at_a_time = np.stack([live.next_frame(y) for y in FRAMES])
    scaled = batch.frames(1e-12 * FRAMES)
    np.testing.assert_allclose(1e12 * scaled, one_at_a_time, rtol=2e-3, atol=2e-3)
    batch.restart()
    at_once = np.concatenate([batch.frames(FRAMES[:3]), batch.frames(FRAMES[3:])])
    assert at_once.dtype == live.precision
    np.testing.assert_allclose(at_once, one_at_a_time, atol=2e-3 * one_at_a_time.max())
    assert batch.frames(FRAMES[:0]).shape == (0, *HIDDEN, 3)
    assert "4x5 patches" in repr(live) and coupling in repr(live)
    if coupling == "none":
        stills = [live.still.reconstruct(y) for y in FRAMES]
        np.testing.assert_allclose(one_at_a_time, stills, atol=2e-2 * np.max(stills))


@pytest.mark.parametrize(("name", "coupling"), COUPLED)
def test_frames_are_recovered_by_the_method_of_their_mask(name, coupling):
    given = {o.name: 3.0 for o in METHODS[name].video.options if o.coupling == coupling}
    video = video_of(name, coupling, **given)
    assert video.coupling == coupling and all(getattr(video, o) == 3.0 for o in given)
    spoilt = np.where(MASK[..., None], FRAMES, np.nan)
    photographs = [Photograph.of(y, mask=MASK, monitor_off={"off": OFF}) for y in spoilt]
    frames = video.frames(photographs)
    video.restart()
    np.testing.assert_array_equal([video.next_frame(y) for y in photographs], frames)
    changed = video.frames([photographs[0], Photograph.of(Y, mask=OTHER)])
    assert np.isfinite(frames).all() and np.isfinite(changed).all()
    assert {"noise", "lambda"} <= video.solve_next(Y).numbers().keys()


@pytest.mark.parametrize(("name", "coupling"), COUPLED)
def test_rejected_photographs_leave_the_video_as_it_was(name, coupling):
    video, undisturbed = video_of(name, coupling), video_of(name, coupling)
    for each in (video, undisturbed):
        each.next_frame(Y)
    for wrong in (np.nan * Y, Y[:-1]):
        with pytest.raises(ValueError, match="photograph"):
            video.next_frame(wrong)
    np.testing.assert_array_equal(video.next_frame(LIT), undisturbed.next_frame(LIT))


@pytest.mark.parametrize("name", VIDEOS)
def test_what_couples_no_frames_is_rejected(name):
    with pytest.raises(ValueError, match="coupling 'optical-flow' is not known"):
        video_of(name, "optical-flow")
    for weight in (-1, np.nan, np.inf):
        with pytest.raises(ValueError, match="give a finite number from 0"):
            video_of(name, "l1", l1_weight=weight)
    with pytest.raises(ValueError, match="recovers no videos"):
        METHODS["differencing"].frames_by(METHODS["differencing"](Scene(), A, B), "none")
