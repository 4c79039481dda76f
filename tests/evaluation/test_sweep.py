import csv
import itertools
import json
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from periscopy_sim.errors import OutputError, PeriscopyError, SceneError
from periscopy_sim.evaluation.metrics import psnr_gain_matched, registered
from periscopy_sim.evaluation.sweep import Sweep, World, flips, run_sweep
from periscopy_sim.numerics.machine import in_parallel
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.preconditioned import Periscope
from tests.scenes.contents import contents

pytestmark = pytest.mark.usefixtures("quick_light")

RNG = np.random.default_rng(5)
SIGNAL = RNG.uniform(0.5, 1, (6, 7, 3))
TRUTH = RNG.uniform(0, 1, (3, 4, 3))
MASK = np.random.default_rng(9).random((6, 7)) > 0.3
LIGHTS = {"lamp": RNG.uniform(1, 3, (6, 7, 3)), "sun": RNG.uniform(5, 9, (6, 7, 3))}


MASKED = Photograph.of(SIGNAL, mask=MASK)


class Linear:
    """The mean of a random part of the photograph for each patch."""

    def __init__(self, seed):
        self.matrix = np.random.default_rng(seed).uniform(-0.2, 1, (12, 42))

    def reconstruct(self, photograph):
        return (self.matrix @ photograph.reshape(42, 3)).reshape(3, 4, 3)


class Moody:
    """Fails in one way or another, as the photograph is; spoils what it was given."""

    def reconstruct(self, photograph):
        bright = photograph[0, 0, 0] > photograph[-1, -1, 0]
        photograph[:] = np.nan
        if bright:
            raise RuntimeError(f"too bright\nfor {self}")
        return np.zeros((4, 3, 3))


def world_of(**changes):
    methods = {"first": Linear(1), "second": Linear(2)}
    base = World({"p": SIGNAL}, {"p": TRUTH}, LIGHTS, methods)
    return replace(base, **changes)


def sweep_of(*, sbrs=(0.1, 1, 10), snrs=(40,), seeds=(0, 1), seed=7, conditions=None, **changes):
    settings = {"seeds": seeds, "seed": seed, "conditions": conditions or {}}
    return Sweep(world_of(**changes), sbrs, snrs, **settings)


def photograph(sweep, background, sbr, seed, snr=40):
    labels = {"image": "p", "background": background, "sbr": sbr, "snr": snr, "seed": seed}
    return sweep.photograph(labels)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A complete sweep: its folder and results."""
    folder = tmp_path_factory.mktemp("done")
    return folder, run_sweep(sweep_of(), folder)


@pytest.mark.parametrize("sbr", [0.1, 1, 10])
def test_photograph_has_its_sbr_and_its_noise(sbr):
    clean = photograph(sweep_of(), "sun", sbr, 0, snr=300)
    # The least-squares parts of signal and background in it.
    columns = np.stack([SIGNAL.ravel(), LIGHTS["sun"].ravel()], axis=1)
    parts = np.linalg.lstsq(columns, clean.ravel())[0] * columns.mean(axis=0)
    assert parts[0] / parts[1] == pytest.approx(sbr)
    assert clean.mean() == pytest.approx(1)
    noise = [photograph(sweep_of(), "sun", sbr, s) - clean for s in range(100)]
    expected = 10 ** (-40 / 20) * np.sqrt(np.mean(clean**2))
    # 12,600 normal values: the standard error of their deviation is 0.63 %.
    assert np.std(noise) == pytest.approx(expected, rel=0.03)
    assert np.mean(noise) == pytest.approx(0, abs=5 * expected / np.sqrt(12600))


def test_noise_follows_from_the_labels_alone():
    y = photograph(sweep_of(), "sun", 1, 1)
    other = sweep_of(
        backgrounds={"more": LIGHTS["lamp"], "sun": LIGHTS["sun"]},
        sbrs=[20, 1.0, 0.1],
        seeds=[1, 5],
        methods={"second": Linear(2)},
    )
    assert np.array_equal(photograph(other, "sun", 1.0, 1), y)


def test_flips_are_the_four_pictures_of_each_background():
    image = np.arange(12.0).reshape(2, 2, 3)
    flipped = flips({"a": image, "b": 2 * image})
    assert list(flipped) == [
        *("a", "a up-down", "a left-right", "a both"),
        *("b", "b up-down", "b left-right", "b both"),
    ]
    corners = {name: picture[:, :, 0].ravel().tolist() for name, picture in flipped.items()}
    assert corners["a up-down"] == [6, 9, 0, 3]
    assert corners["a left-right"] == [3, 0, 9, 6]
    assert corners["b both"] == [18, 12, 6, 0]


def test_only_what_the_mask_leaves_is_exposed_and_noisy():
    masked = sweep_of(signals={"p": MASKED})
    y = photograph(masked, "sun", 0.5, 0, snr=20)
    clean = photograph(masked, "sun", 0.5, 0, snr=300)
    signal, light = SIGNAL[MASK], LIGHTS["sun"][MASK]
    expected = signal / signal.mean() + light / light.mean() / 0.5
    assert np.allclose(clean[MASK], expected / expected.mean(), rtol=1e-12)
    noise = np.std(y[MASK] - clean[MASK]) / np.sqrt(np.mean(clean[MASK] ** 2))
    # About 90 normal values: the standard error of their deviation is 7.5 %.
    assert noise == pytest.approx(0.1, rel=0.35)
    assert y.shape == SIGNAL.shape and not y[~MASK].any() and not clean[~MASK].any()


def test_pixels_under_the_mask_change_no_measurement():
    signal, light = (
        np.where(MASK[..., None], y, [np.nan, np.inf, -1e9]) for y in (SIGNAL, LIGHTS["sun"])
    )
    masked = Photograph.of(signal, mask=MASK)
    spoilt = sweep_of(signals={"p": masked}, backgrounds={"sun": light})
    expected = photograph(sweep_of(signals={"p": MASKED}), "sun", 1, 0)
    assert np.array_equal(photograph(spoilt, "sun", 1, 0), expected)


def test_results_are_labelled_and_are_what_the_methods_give(done):
    _, results = done
    assert dict(results.sizes) == {
        "algorithm": 2, "image": 1, "background": 2, "sbr": 3, "snr": 1, "seed": 2, "row": 3,
        "column": 4, "channel": 3,
    }  # fmt: skip
    assert results["channel"].values.tolist() == ["red", "green", "blue"]
    assert results["reconstruction"].dtype == np.float32
    sweep, methods = sweep_of(), world_of().methods
    for name, light, sbr, seed in itertools.product(methods, LIGHTS, [0.1, 1, 10], [0, 1]):
        cell = results.squeeze().sel(algorithm=name, background=light, sbr=sbr, seed=seed)
        image = methods[name].reconstruct(photograph(sweep, light, sbr, seed))
        assert np.allclose(cell["reconstruction"], image, rtol=1e-6)
        psnr = {"psnr": psnr_gain_matched(image, TRUTH)}
        psnr |= {"psnr_registered": registered(image, TRUTH).psnr}
        assert {name: float(cell[name]) for name in psnr} == pytest.approx(psnr, abs=1e-4)
        error = 10 ** (-psnr["psnr"] / 10)
        assert float(cell["mean_squared_error"]) == pytest.approx(error, rel=1e-5)
        assert cell["failure"] == ""


def test_store_opens_in_xarray_and_its_table_in_any_program(done):
    folder, results = done
    with xr.open_dataset(folder / "sweep.zarr", engine="zarr", consolidated=False) as stored:
        assert np.array_equal(stored["psnr"], results["psnr"])
    metadata = json.loads((folder / "sweep.zarr" / "zarr.json").read_text())
    assert metadata["zarr_format"] == 3
    with (folder / "sweep.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 2 * 2 * 3 * 2
    for row in rows:
        place = {"algorithm": row["algorithm"], "background": row["background"]}
        place |= {"sbr": float(row["sbr"]), "seed": int(row["seed"])}
        assert float(row["psnr"]) == float(results["psnr"].squeeze().sel(place))
        assert row["failure"] == ""


def test_method_that_fails_fails_alone(tmp_path):
    methods = {"moody": Moody(), "first": Linear(1)}
    lights = {"left": np.ones((6, 7, 3)), "right": np.ones((6, 7, 3))}
    lights["left"][0, 0] = lights["right"][-1, -1] = 2
    sweep = sweep_of(methods=methods, backgrounds=lights, sbrs=[1e-3])
    results = run_sweep(sweep, tmp_path)
    moody, first = (results.sel(algorithm=name) for name in methods)
    for metric in ("mean_squared_error", "psnr", "psnr_registered", "reconstruction"):
        assert np.isnan(moody[metric]).all()
        assert np.isfinite(first[metric]).all()
    messages = {name: set(moody["failure"].sel(background=name).values.flat) for name in lights}
    (raised,) = messages["left"]
    assert raised.startswith("RuntimeError: too bright for <") and raised.endswith(" at 0x...>")
    (wrong,) = messages["right"]
    assert wrong.startswith("ValueError: ") and "(4, 3, 3) instead of" in wrong
    assert set(first["failure"].values.flat) == {""}
    table = (tmp_path / "sweep.csv").read_text()
    assert f"moody,p,left,0.001,40.0,0,{'nan,' * 7}{raised}" in table
    again = []
    mended = sweep_of(
        methods={"moody": Linear(1), "first": Moody()}, backgrounds=lights, sbrs=[1e-3]
    )
    results = run_sweep(mended, tmp_path, planned=again.extend)
    assert {cell["algorithm"] for cell in again} == {"moody"} and not results["failure"].any()
    assert np.array_equal(results["psnr"][0], results["psnr"][1])


class Worlds:
    """A world for each value of an axis but one."""

    def __init__(self, wrong):
        self.wrong, self.world = wrong, world_of()

    def __getattr__(self, name):
        return getattr(self.world, name)

    def __call__(self, snr, place):  # noqa: ARG002
        if place in self.wrong:
            raise SceneError(f"no world at {place:g}")
        return self.world


def test_value_without_a_world_fails_alone_and_values_of_a_later_run_take_their_place(tmp_path):
    def swept(*places, wrong=(2.0,)):
        return run_sweep(Sweep(Worlds(wrong), [1.0], vary={"place": places}), tmp_path)

    with pytest.raises(PeriscopyError, match="at 2"):
        swept(2.0)
    results = swept(3.0, 2.0)
    failed = results["failure"] != ""
    assert failed.sel(place=2).all() and not failed.sel(place=3).any()
    assert np.isnan(results["psnr"].sel(place=2)).all()
    left_over = tmp_path / "sweep.zarr/making/finished/.0123abcd-89abcdef.partial.json"
    left_over.write_text("of a process that was killed")
    assert swept(3.0, 1.0)["place"].values.tolist() == [1, 3] and not left_over.exists()


def test_seconds_count_the_work_of_all_threads(tmp_path):
    class Busy:
        def reconstruct(self, _):
            in_parallel(lambda _: busy(0.05), range(8))
            return np.zeros((3, 4, 3))

    def busy(seconds):
        end = time.thread_time() + seconds
        while time.thread_time() < end:
            sum(range(1000))

    times = []
    run_sweep(
        sweep_of(methods={"busy": Busy()}, sbrs=[1], seeds=[0]), tmp_path,
        timed=lambda name, seconds: times.append((name, seconds)),
    )  # fmt: skip
    assert {name for name, _ in times} == {"busy"} and min(each for _, each in times) >= 0.4


def test_plain_psnr_needs_no_gain_of_what_has_the_unit_of_the_matrix(tmp_path):
    """A of 42 pixels and 12 patches; the pseudo-inverse of A and of the ambient light."""
    A = RNG.uniform(0, 1, (42, 12))
    signal = (A @ TRUTH.reshape(12, 3)).reshape(6, 7, 3)

    class Exact:
        def reconstruct(self, photograph):
            known = np.concatenate([A, LIGHTS["sun"].reshape(42, 3)], axis=1)
            return (np.linalg.pinv(known) @ photograph.reshape(42, 3))[:12].reshape(3, 4, 3)

    world = world_of(signals={"p": signal}, methods={"exact": Exact(), "first": Linear(1)},
                     backgrounds={"sun": LIGHTS["sun"]})  # fmt: skip
    results = run_sweep(Sweep(world, [0.3, 5.0], [280.0]), tmp_path).squeeze()
    assert (results["psnr_plain"].sel(algorithm="exact") > 100).all()
    assert (results["psnr_plain"] < results["psnr"])[1].all()


def test_an_infinite_ratio_is_a_photograph_without_ambient_light(tmp_path):
    sweep = sweep_of(sbrs=[np.inf, 1e12], snrs=[200.0])
    cell = {"image": "p", "background": "sun", "seed": 0, "snr": 200.0}
    dark, nearly = (sweep.photograph({**cell, "sbr": sbr}) for sbr in (np.inf, 1e12))
    np.testing.assert_allclose(dark, SIGNAL / SIGNAL.mean(), rtol=1e-8)
    np.testing.assert_allclose(dark, nearly, rtol=1e-8)
    results = run_sweep(sweep, tmp_path)
    assert results.sbr.values.tolist() == [1e12, np.inf] and results.psnr.notnull().all()
    assert (
        run_sweep(sweep, tmp_path, planned=lambda cells: cells and pytest.fail("again")) is not None
    )


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"methods": {}}, "algorithm"),
        ({"seeds": [1, 1]}, "seed"),
        ({"sbrs": [1, 0]}, "sbrs"),
        ({"snrs": [np.inf]}, "snrs"),
        ({"backgrounds": {"lamp": SIGNAL[1:]}}, "lamp'"),
        ({"signals": {"p": SIGNAL * np.nan}}, "p"),
        ({"truths": {"q": TRUTH}}, "q"),
        ({"backgrounds": {"lamp": SIGNAL[..., :1]}}, "lamp'"),
    ],
)
def test_impossible_sweep_is_rejected(changes, name):
    with pytest.raises(PeriscopyError, match=name):
        sweep_of(**changes)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"backgrounds": {**LIGHTS, "sun": LIGHTS["lamp"]}}, "background 'sun' has changed"),
        ({"seed": 8}, "holds another sweep \\(base_seed"),
        ({"conditions": {"A": 1}}, "holds another sweep \\(A"),
        ({"signals": {"p": MASKED}}, "holds another sweep \\(mask_sha256"),
        ({"signals": {"p": SIGNAL + 1}}, "image 'p' .* has changed"),
    ],
)
def test_folder_of_another_sweep_is_refused_untouched(changes, key, done):
    folder, _ = done
    before = contents(folder)
    with pytest.raises(OutputError, match=key):
        run_sweep(sweep_of(**changes), folder)
    assert contents(folder) == before


@pytest.mark.parametrize(
    "more",
    [
        {
            "sbrs": (0.1, 3, 1, 10),
            "methods": {"first": Linear(1), "third": Linear(3), "second": Linear(2)},
        },
        {"signals": {"p": SIGNAL, "q": SIGNAL + 1}, "truths": {"p": TRUTH, "q": TRUTH / 2}},
    ],
)
def test_more_values_compute_only_their_cells(more, done, tmp_path):
    seen, missing = [], []
    shutil.copytree(done[0], tmp_path, dirs_exist_ok=True)
    grown = run_sweep(
        sweep_of(**more), tmp_path, progress=seen.append, planned=missing.extend
    )  # fmt: skip
    assert len(missing) == len(seen) == grown.psnr.size - done[1].psnr.size
    fresh = run_sweep(sweep_of(**more), tmp_path / "fresh")
    assert grown.identical(fresh)
    assert seen[0] > done[1].psnr.size / grown.psnr.size
    assert (tmp_path / "sweep.csv").read_bytes() == (tmp_path / "fresh/sweep.csv").read_bytes()
    before, head = contents(tmp_path / "sweep.zarr"), tmp_path / "sweep.zarr/zarr.json"
    assert run_sweep(sweep_of(), tmp_path).identical(done[1])
    after = contents(tmp_path / "sweep.zarr")
    assert {name for name in after if after[name] != before.get(name)} == {"zarr.json"}
    assert json.loads(head.read_text())["attributes"]["asked"] == sweep_of().axes


def test_worlds_vary_and_are_made_only_for_missing_cells(tmp_path):
    def swept(sizes):
        vary = {"bright": [1.0, 2.0], "hidden": sizes}
        made.clear()
        return run_sweep(Sweep(Made(), [1], vary=vary, units={"bright": "1"}), tmp_path)

    class Made:
        """Worlds of flat images, as bright and of the size as asked for."""

        like = world_of(methods={"flat": Flat(None)})
        axes, hidden, channels = like.axes, like.hidden, 3
        conditions, conditions_of, measures = {}, {}, {}

        def __call__(self, snr, bright, hidden):  # noqa: ARG002
            made.append((bright, hidden))
            truth = np.full((*map(int, hidden.split("x")), 3), 0.5)
            methods = {"flat": Flat(truth)}
            return world_of(signals={"p": bright * SIGNAL}, truths={"p": truth}, methods=methods)

    made = []
    results = swept(["2x3", "3x4"])
    assert len(made) == 4 and results.psnr.dims[:3] == ("algorithm", "bright", "hidden")
    assert results.bright.attrs["units"] == "1" and results.snr.attrs["units"] == "dB"
    images = results["reconstruction_2x3"].squeeze()
    assert (images.sel(hidden="2x3") == 0.5).all() and images.sel(hidden="3x4").isnull().all()
    assert "reconstruction_2x3" not in swept(["3x4", "4x4"])
    assert made == [(1.0, "4x4"), (2.0, "4x4")]
    with pytest.raises(OutputError, match="bright, hidden"):
        run_sweep(sweep_of(), tmp_path)


class Flat:
    """Always the same image."""

    def __init__(self, image):
        self.image = image

    def reconstruct(self, _):
        return self.image


def test_interrupted_sweep_goes_on(done, tmp_path):
    def interrupt(fraction):
        seen.append(fraction)
        if len(seen) == 4:
            raise KeyboardInterrupt

    seen = []
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep_of(), tmp_path, progress=interrupt)
    assert np.allclose(seen, np.arange(1, 5) / 24)
    seen.clear()
    run_sweep(sweep_of(), tmp_path, progress=lambda fraction: seen.append(fraction))
    assert np.allclose(seen, np.arange(5, 25) / 24)
    assert contents(tmp_path) == contents(done[0])


def test_workers_elsewhere_give_the_same_bytes(done, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp://",
        dashboard_address="127.0.0.1:0",
    ) as cluster:  # fmt: skip
        run_sweep(sweep_of(), tmp_path, scheduler=cluster.scheduler_address)
    assert contents(tmp_path) == contents(done[0])


def test_photographs_give_a_sweep_their_mask_and_their_monitor_off_photographs():
    given = Photograph.of(np.where(MASK[..., None], SIGNAL, np.nan), mask=MASK)
    A, off = RNG.uniform(0.1, 1, (42, 4)), RNG.uniform(0.5, 1, SIGNAL.shape)
    settings = {"hidden": (2, 2), "photograph_shape": (6, 7)}
    method = Periscope(A, **settings)
    ours = world_of(signals={"p": given}, methods={"p": method})
    y = ours.photograph("p", "sun", 1, 40, 0)
    expected = method.reconstruct(Photograph.of(y, mask=MASK))
    np.testing.assert_array_equal(ours.methods["p"].reconstruct(y), expected)
    lit = Photograph.of(SIGNAL, monitor_off={"off": off})
    with_off = world_of(signals={"p": lit}, methods={"p": method})
    assert with_off.methods["p"].fit.monitor_off.keys() == {"off"}
    assert with_off.conditions != world_of(methods={"p": method}).conditions


def test_grey_photographs_give_grey_images_compared_with_the_mean_of_a_coloured_truth(tmp_path):
    A = RNG.uniform(0.1, 1, (42, 4)).astype(np.float32)
    truth = RNG.uniform(0.2, 1, (2, 2, 3))
    y = (A @ truth.mean(axis=2).ravel()).reshape(6, 7, 1)
    method = Periscope(A, hidden=(2, 2), tv_weight=0, repair_threshold=np.inf)
    light = {"lamp": np.ones((6, 7, 1))}
    world = World({"q": y}, {"q": truth}, light, {"p": method})
    results = run_sweep(Sweep(world, [1e6], [200]), tmp_path)
    assert results.reconstruction.shape[-3:] == (2, 2, 1) and results.channel.values == ["grey"]
    assert results.psnr.item() > 50


def test_an_image_and_a_light_of_one_name_have_errors_of_their_own():
    signal = Photograph(np.ones((6, 7, 3)), relative_error=3e-3)
    light = Photograph(np.ones((6, 7, 3)), relative_error=4e-3)
    world = world_of(signals={"p": signal}, backgrounds={"p": light, "of a file": LIGHTS["sun"]})
    assert world.own_error("p", "p", 1) == pytest.approx(np.hypot(3e-3, 4e-3) / 2)
    assert world.own_error("p", "of a file", 1e9) == pytest.approx(3e-3)
    assert world_of().own_error("p", "sun", 1) is None
