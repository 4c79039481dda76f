import csv
import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.evaluation.sweep import Sweep, flips, run_sweep
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.preconditioned.still import Periscope
from tests.contents import contents

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


def sweep_of(**changes):
    methods = {"first": Linear(1), "second": Linear(2)}
    base = Sweep(SIGNAL, TRUTH, LIGHTS, methods, [0.1, 1, 10], snr=40, seeds=range(2), seed=7)
    return replace(base, **changes)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A complete sweep: its folder and results."""
    folder = tmp_path_factory.mktemp("done")
    return folder, run_sweep(sweep_of(), folder)


@pytest.mark.parametrize("sbr", [0.1, 1, 10])
def test_photograph_has_its_sbr_and_its_noise(sbr):
    clean = replace(sweep_of(), snr=300).photograph("sun", sbr, 0)
    # The least-squares parts of signal and background in it.
    columns = np.stack([SIGNAL.ravel(), LIGHTS["sun"].ravel()], axis=1)
    parts = np.linalg.lstsq(columns, clean.ravel())[0] * columns.mean(axis=0)
    assert parts[0] / parts[1] == pytest.approx(sbr)
    assert clean.mean() == pytest.approx(1)
    noise = [sweep_of(seeds=[s]).photograph("sun", sbr, s) - clean for s in range(100)]
    expected = 10 ** (-40 / 20) * np.sqrt(np.mean(clean**2))
    # 12,600 normal values: the standard error of their deviation is 0.63 %.
    assert np.std(noise) == pytest.approx(expected, rel=0.03)
    assert np.mean(noise) == pytest.approx(0, abs=5 * expected / np.sqrt(12600))


def test_noise_follows_from_the_labels_alone():
    y = sweep_of().photograph("sun", 1, 1)
    other = sweep_of(
        backgrounds={"more": LIGHTS["lamp"], "sun": LIGHTS["sun"]},
        sbrs=[20, 1.0, 0.1],
        seeds=[1, 5],
        methods={"second": Linear(2)},
    )
    assert np.array_equal(other.photograph("sun", 1.0, 1), y)


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
    y = sweep_of(signal=MASKED, snr=20).photograph("sun", 0.5, 0)
    clean = sweep_of(signal=MASKED, snr=300).photograph("sun", 0.5, 0)
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
    spoilt = sweep_of(signal=masked, backgrounds={"sun": light})
    expected = sweep_of(signal=MASKED).photograph("sun", 1, 0)
    assert np.array_equal(spoilt.photograph("sun", 1, 0), expected)


def test_results_are_labelled_and_are_what_the_methods_give(done):
    _, results = done
    assert dict(results.sizes) == {
        "algorithm": 2, "background": 2, "sbr": 3, "seed": 2, "row": 3, "column": 4, "channel": 3
    }  # fmt: skip
    assert results["channel"].values.tolist() == ["red", "green", "blue"]
    assert results["reconstruction"].dtype == np.float32
    sweep = sweep_of()
    for name, light, sbr, seed in itertools.product(sweep.methods, LIGHTS, [0.1, 1, 10], [0, 1]):
        cell = results.sel({"algorithm": name, "background": light, "sbr": sbr, "seed": seed})
        image = sweep.methods[name].reconstruct(sweep.photograph(light, sbr, seed))
        assert np.allclose(cell["reconstruction"], image, rtol=1e-6)
        error, best = error_of(image), min(
            error_of(ndimage.shift(image, (d / 2, r / 2, 0), order=1, mode="grid-constant"))
            for d in range(-4, 5)
            for r in range(-4, 5)
        )  # fmt: skip
        assert float(cell["mean_squared_error"]) == pytest.approx(error, rel=1e-5)
        assert float(cell["psnr"]) == pytest.approx(-10 * np.log10(error), abs=1e-4)
        assert float(cell["psnr_registered"]) == pytest.approx(-10 * np.log10(best), abs=1e-4)
        assert cell["failure"] == ""


def error_of(image):
    positive = np.maximum(image, 0)
    matched = [
        np.clip(np.linalg.lstsq(p.reshape(-1, 1), t.ravel())[0] * p, 0, 1) - t
        for p, t in zip(positive.transpose(2, 0, 1), TRUTH.transpose(2, 0, 1), strict=True)
    ]
    return np.mean(np.square(matched))


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
        assert float(row["psnr"]) == float(results["psnr"].sel(place))
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
    assert f"moody,left,0.001,0,nan,nan,nan,{raised}" in table


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"methods": {}}, "algorithm"),
        ({"seeds": [1, 1]}, "seed"),
        ({"sbrs": [1, 0]}, "SBR"),
        ({"snr": np.inf}, "SNR"),
        ({"backgrounds": {"lamp": SIGNAL[1:]}}, "'lamp'"),
        ({"signal": SIGNAL * np.nan}, "signal"),
        ({"backgrounds": {"lamp": SIGNAL[..., :1]}}, "'lamp'"),
    ],
)
def test_impossible_sweep_is_rejected(changes, name):
    with pytest.raises(PeriscopyError, match=name):
        sweep_of(**changes)


def test_complete_sweep_is_not_done_again(done):
    folder, results = done
    before = contents(folder)
    again = run_sweep(sweep_of(methods={"first": Moody(), "second": Moody()}), folder)
    assert again.identical(results)
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"methods": {"first": Linear(1)}}, "algorithms"),
        ({"backgrounds": {**LIGHTS, "sun": LIGHTS["lamp"]}}, "background_sha256.sun"),
        ({"seed": 8}, "base_seed"),
        ({"conditions": {"A": 1}}, "A"),
        ({"signal": Photograph.of(SIGNAL, mask=MASK)}, "mask_sha256"),
    ],
)
def test_folder_of_another_sweep_is_refused_untouched(changes, key, done):
    folder, _ = done
    before = contents(folder)
    with pytest.raises(OutputError, match=f"holds another sweep \\({key}"):
        run_sweep(sweep_of(**changes), folder)
    assert contents(folder) == before


def test_interrupted_sweep_goes_on(done, tmp_path):
    def interrupt(fraction):
        seen.append(fraction)
        if len(seen) == 4:
            raise KeyboardInterrupt

    seen = []
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep_of(), tmp_path, progress=interrupt)
    assert np.allclose(seen, np.arange(1, 5) / 12)
    seen.clear()
    run_sweep(sweep_of(), tmp_path, progress=lambda fraction: seen.append(fraction))
    assert np.allclose(seen, np.arange(5, 13) / 12)
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
    ours = sweep_of(signal=given, methods={"p": method})
    y = ours.photograph("sun", 1, 0)
    expected = method.reconstruct(Photograph.of(y, mask=MASK))
    np.testing.assert_array_equal(ours.methods["p"].reconstruct(y), expected)
    lit = Photograph.of(SIGNAL, monitor_off={"off": off})
    with_off = sweep_of(signal=lit, methods={"p": method})
    assert with_off.methods["p"].fit.monitor_off.keys() == {"off"}
    assert with_off.configuration() != sweep_of(methods={"p": method}).configuration()
    with pytest.raises(PeriscopyError, match="monitor off"):
        sweep_of(signal=lit)


def test_grey_photographs_give_grey_images_compared_with_the_mean_of_a_coloured_truth(tmp_path):
    A = RNG.uniform(0.1, 1, (42, 4)).astype(np.float32)
    truth = RNG.uniform(0.2, 1, (2, 2, 3))
    y = (A @ truth.mean(axis=2).ravel()).reshape(6, 7, 1)
    method = Periscope(A, hidden=(2, 2), tv_weight=0, repair_threshold=np.inf)
    light = {"lamp": np.ones((6, 7, 1))}
    sweep = Sweep(y, truth, light, {"p": method}, [1e6], snr=200)
    results = run_sweep(sweep, tmp_path)
    assert results.reconstruction.shape[-3:] == (2, 2, 1) and results.channel.values == ["grey"]
    assert results.psnr.item() > 50
