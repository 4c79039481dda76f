import json

import numpy as np
import pytest

import periscopy_sim as ps

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.torch

from experiments.learned import train  # noqa: E402
from experiments.learned.samples import Samples  # noqa: E402
from periscopy_sim.hidden import Hidden  # noqa: E402
from periscopy_sim.model.spectral_basis import SpectralBasis  # noqa: E402

SHAPE = 29, 36


@pytest.fixture(scope="module", name="samples")
def written(tmp_path_factory):
    """Smooth images whose starts are too bright in one corner, of a scene that shows little."""
    folder = tmp_path_factory.mktemp("samples")
    rng = np.random.default_rng(0)
    N = SHAPE[0] * SHAPE[1]
    basis = SpectralBasis.of_gram(np.diag(rng.random(N) + 0.1), Hidden.of(SHAPE))
    for number, (split, kind) in enumerate(
        [("train", "right"), ("train", "ruler"), ("validation", "right"), ("validation", "ruler")]
    ):
        n = 20
        truth = np.broadcast_to(rng.random((n, 3, 1, 1)) + 0.2, (n, 3, *SHAPE)).astype(np.float32)
        start = truth.copy()
        start[..., :10, :10] += 0.5
        Samples(
            basis.rows,
            basis.curvatures.astype(np.float32),
            np.zeros((n, 3, N), np.float32),
            np.full((n, 3, N), 1e-6, np.float32),
            np.full((n, *SHAPE), 0.3, np.float32),
            start,
            truth,
            split,
        ).write(folder / f"{number:03d}_{kind}.npz")
    return folder


def test_error_is_the_metrics_own_after_the_best_gain():
    rng = np.random.default_rng(1)
    truth = rng.random((1, 3, 5, 6))
    image = truth * np.array([0.3, 2.0, 1.0])[:, None, None] + rng.normal(0, 0.1, truth.shape)
    planes = torch.tensor(image), torch.tensor(truth)
    found = train.matched(*planes)[0].numpy()
    expected = ps.gain_matched(np.moveaxis(image[0], 0, -1), np.moveaxis(truth[0], 0, -1))
    clipped = np.clip(np.moveaxis(found, 0, -1), 0, 1)
    assert clipped == pytest.approx(expected, abs=1e-12)
    error = float(train.error(train.matched(*planes), planes[1]))
    mean = np.mean((found - truth[0]) ** 2)
    assert error == pytest.approx(10 * np.log10(mean + train.GOOD))


def test_right_scenes_pay_for_a_wrong_brightness_and_rulers_scenes_do_not():
    truth = torch.rand(2, 3, 4, 5, generator=torch.Generator().manual_seed(0))
    alike = [float(train.loss_of(factor * truth, truth, right=False)) for factor in (1, 1.5)]
    assert alike[0] == pytest.approx(alike[1], abs=1e-3)
    assert float(train.loss_of(1.5 * truth, truth, True)) > 5 + float(
        train.loss_of(truth, truth, True)
    )


def test_training_learns_resumes_and_writes_weights_with_their_provenance(
    samples, tmp_path, monkeypatch
):
    monkeypatch.setattr(train, "CHECKED", 2)
    monkeypatch.setattr(train, "BATCH", 4)
    train.main(samples, tmp_path / "whole", steps=6, threads=1, seed=3)
    clip, left = train.clip_grad_norm_, iter(range(3))

    def stop_at_the_fourth(*given):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return clip(*given)

    with monkeypatch.context() as patched:
        patched.setattr(train, "clip_grad_norm_", stop_at_the_fourth)
        with pytest.raises(KeyboardInterrupt):
            train.main(samples, tmp_path / "stopped", steps=6, threads=1, seed=3)
    train.main(samples, tmp_path / "stopped", steps=6, threads=1, seed=3)
    whole, stopped = (
        dict(np.load(tmp_path / name / "unrolled.npz")) for name in ("whole", "stopped")
    )
    for name, values in whole.items():
        np.testing.assert_array_equal(values, stopped[name])
    provenance = json.loads(str(whole["provenance"]))
    assert provenance["training_steps"] == 6 and provenance["photographs"] == 40
    assert len(provenance["samples_sha256"]) == 64
    curves = json.loads((tmp_path / "whole" / "unrolled.json").read_text())
    assert curves["right"][-1] < curves["noise_aware"]
    assert (tmp_path / "whole" / "unrolled.png").is_file()
    with pytest.raises(SystemExit, match="is of 6 steps and seed 3"):
        train.main(samples, tmp_path / "whole", steps=7, threads=1, seed=3)
    next(samples.glob("*.npz")).unlink()
    with pytest.raises(SystemExit, match="learned from other samples"):
        train.main(samples, tmp_path / "whole", steps=6, threads=1, seed=3)
