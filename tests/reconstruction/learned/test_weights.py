import sys

import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.learned.still import Learned
from periscopy_sim.reconstruction.learned.weights import Weights, read_weights, write_weights
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware


@pytest.mark.parametrize("library", ["torch", "safetensors"])
def test_without_a_library_one_line_says_what_to_install(library, monkeypatch, small):
    if library == "safetensors":
        pytest.importorskip("torch")
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(PeriscopyError, match=rf"needs {library}.*pip install -e '\.\[torch\]'"):
        Learned(small.A, small.B, weights="any", **small.settings)


@pytest.fixture(name="file")
def written(tmp_path):
    torch = pytest.importorskip("torch")
    pytest.importorskip("safetensors")
    from periscopy_sim.reconstruction.learned.unrolled_network import UnrolledNetwork

    torch.manual_seed(1)
    network = UnrolledNetwork(steps=2, width=4)
    file = tmp_path / "mine.safetensors"
    settings = {"steps": 2, "width": 4}
    write_weights(Weights(network.state_dict(), (4, 5), settings, {"seed": 1}), file)
    return file


@pytest.mark.torch
def test_untrained_weights_give_the_noise_aware_image_in_any_unit(file, small):
    method = Learned(small.A, small.B, weights=file, **small.settings)
    expected = NoiseAware(small.A, small.B, **small.settings).reconstruct(small.photograph)
    for unit in (1.0, 3e4):
        image = method.reconstruct(unit * small.photograph)
        assert image == pytest.approx(unit * expected, rel=1e-4, abs=unit * 1e-5)
    report = method.report(small.photograph, method.solve(small.photograph))
    assert report.standard_errors is None
    assert report.numbers["weights_sha256"] == method.provenance["sha256"]
    assert method.provenance["seed"] == 1 and len(method.provenance["sha256"]) == 64


@pytest.mark.torch
def test_black_photograph_gives_a_black_image(file, small):
    method = Learned(small.A, small.B, weights=file, **small.settings)
    assert not method.reconstruct(0 * small.photograph).any()


@pytest.mark.torch
def test_weights_of_another_size_are_refused_by_name_and_hash(file, small):
    digest = read_weights(file).digest[:12]
    other = {**small.settings, "hidden": (5, 4)}
    with pytest.raises(ValueError, match=rf"mine\.safetensors \({digest}\).*4x5 .* 5x4"):
        Learned(small.A, small.B, weights=file, **other)


@pytest.mark.torch
def test_one_flipped_bit_is_refused_by_hash(file):
    whole = bytearray(file.read_bytes())
    whole[-7] ^= 4
    file.write_bytes(whole)
    with pytest.raises(PeriscopyError, match=r"mine\.safetensors: .*SHA-256"):
        read_weights(file)


@pytest.mark.torch
@pytest.mark.parametrize("kept", [0, 5, 200, -1])
def test_cut_file_is_refused(file, kept):
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(PeriscopyError, match=r"mine\.safetensors"):
        read_weights(file)


@pytest.mark.torch
def test_file_of_something_else_is_refused(tmp_path):
    torch = pytest.importorskip("torch")
    save = pytest.importorskip("safetensors.torch").save_file
    file = tmp_path / "other.safetensors"
    save({"a": torch.zeros(2)}, file)
    with pytest.raises(PeriscopyError, match=r"other\.safetensors"):
        read_weights(file)
    with pytest.raises(PeriscopyError, match=r"none\.safetensors"):
        read_weights(tmp_path / "none.safetensors")


@pytest.mark.torch
@pytest.mark.parametrize("settings", [{"steps": 2, "width": 8}, {"depth": 3}])
def test_network_of_other_settings_than_recorded_is_refused(file, settings):
    tensors = read_weights(file).tensors
    write_weights(Weights(tensors, (4, 5), settings, {}), file)
    with pytest.raises(PeriscopyError, match=r"mine\.safetensors: .* settings"):
        read_weights(file).network(file)
