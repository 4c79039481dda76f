"""Transport matrices as commands are asked for them: from files, with bounces, within memory."""

import json
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.cli.fitting.transport_matrix import check_memory
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics import memory
from periscopy_sim.photographs.film.size import FilmAdvice
from periscopy_sim.rendering.transport import bounced, bounced_transport
from periscopy_sim.storage.transport_matrix import read_transport

pytestmark = pytest.mark.usefixtures("jit")

HIDDEN = ("--hidden", "4x5", "--samples", "4")
TINY = ("-D", "resolution=24", *HIDDEN)
OUT = ("--out", "A.npy")


# -- matrices ------------------------------------------------------------------------------------

MATRIX = np.random.default_rng(5).random((576, 20))


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (MATRIX[:, :19], "shape (576, 19); the scene's camera and hidden size need (576, 20)"),
        (MATRIX.T, "shape (20, 576)"),
        (MATRIX.ravel(), "shape (11520,)"),
        (np.where(np.arange(20) == 7, np.nan, MATRIX), "NaN or infinities"),
        (np.where(np.arange(20) == 7, np.inf, MATRIX), "NaN or infinities"),
        (MATRIX.astype(complex), "complex numbers"),
        (MATRIX > 0.5, "truth values"),
        (np.ones((576, 20)), "B explains all of it"),
        (np.zeros((576, 20)), "B explains all of it"),
    ],
)
@pytest.mark.usefixtures("few_lights")
def test_matrix_that_cannot_be_of_the_scene_is_refused(matrix, message, refused, tmp_path):
    np.save(tmp_path / "A.npy", matrix)
    np.save(tmp_path / "y.npy", np.ones((24, 24)))
    arguments = ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--transport", "A.npy")
    line = refused(*arguments, "--out", "r")
    assert line.startswith("A.npy: ") and message in line


def test_matrix_file_that_cannot_be_read_is_refused(refused, tmp_path):
    np.save(tmp_path / "y.npy", np.ones((24, 24)))
    np.save(tmp_path / "A.npy", MATRIX)
    arguments = ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--out", "r", "--transport")
    assert refused(*arguments, "B.npy") == "B.npy: no such file; check the path"
    (tmp_path / "cut.npy").write_bytes((tmp_path / "A.npy").read_bytes()[:-1])
    assert "cut.npy: cannot be read as NPY" in refused(*arguments, "cut.npy")
    np.savez(tmp_path / "A.npz", A=MATRIX)
    assert "A.npz: is no NPY file" in refused(*arguments, "A.npz")


@pytest.mark.parametrize("other", [("-D", "occluder_dx=0.01"), ("-D", "monitor_dz=0.01")])
def test_matrix_of_another_pose_is_refused(other, refused, succeeds, tmp_path):
    succeeds("transport", "chair", *TINY, *other, "--out", "A.npy")
    np.save(tmp_path / "y.npy", np.ones((24, 24)))
    arguments = ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--transport", "A.npy")
    line = refused(*arguments, "--out", "r")
    assert line.startswith("A.npy: was made from another scene (parameters ")
    assert other[1].split("=")[0] in line


def test_damaged_record_of_a_matrix_is_refused(refused, succeeds, tmp_path):
    succeeds("transport", "chair", *TINY, "--out", "A.npy")
    (tmp_path / "A.json").write_text("{")
    np.save(tmp_path / "y.npy", np.ones((24, 24)))
    arguments = ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--transport", "A.npy")
    assert refused(*arguments, "--out", "r").startswith("A.json: ")


def test_matrix_without_a_record_is_taken_with_a_warning(periscopy, succeeds, tmp_path):
    succeeds("transport", "chair", *TINY, "--out", "A.npy")
    (tmp_path / "A.json").unlink()
    y = np.load(tmp_path / "A.npy") @ np.ones((20, 3))
    np.save(tmp_path / "y.npy", y.reshape(24, 24, 3))
    arguments = ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--transport", "A.npy")
    outcome = periscopy(*arguments, "--out", "r")
    assert outcome.code == 0
    assert outcome.err == (
        "periscopy: warning: A.npy has no JSON file beside it: it may be of another scene of this "
        "size\n"
    )


@pytest.mark.parametrize(
    ("method", "shape", "other"),
    [
        (None, (960_000, 4096), False),
        ("noise-aware", (20_000, 20_000), True),  # 10.6 GB, by the iterative one 6.2
        ("truncated-svd", (20_000, 20_000), True),
        ("noise-aware", (960_000, 4096), False),  # not even that one
        ("iterative", (960_000, 4096), False),
        ("mine.py:Mine", (960_000, 4096), False),
    ],
)
def test_what_does_not_fit_in_memory_is_refused_with_advice(method, shape, other, monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 8 * 10**9)
    with pytest.raises(PeriscopyError, match=r"need about .* GB of memory, where 8.0 GB") as error:
        check_memory(SimpleNamespace(transport_shape=shape), method)
    message = str(error.value)
    assert "--bin" in message and "--hidden" in message and "\n" not in message
    assert ("--method iterative" in message) == other


def test_prepare_and_the_methods_estimate_memory_alike(monkeypatch):
    """A film that `prepare` calls too large is one that the default method refuses."""
    advice = FilmAdvice(0.01, 0.001, (100, 100), 1000)
    for side in range(100, 1000, 50):
        needed = 0.6e9 + 25 * side**2 * 1000
        for available in (0.99 * needed, 1.01 * needed):
            monkeypatch.setattr(memory, "available_memory", lambda size=available: size)
            scenario = SimpleNamespace(transport_shape=(side**2, 1000))
            if advice.fits((side, side)):
                check_memory(scenario, "noise-aware")
            else:
                with pytest.raises(PeriscopyError):
                    check_memory(scenario, "noise-aware")
            assert advice.fits((side, side)) == (available > needed)


def test_memory_is_told_where_it_is_much(monkeypatch, capfd):
    monkeypatch.setattr(memory, "available_memory", lambda: 10**12)
    check_memory(SimpleNamespace(transport_shape=(15000, 576)), "noise-aware")
    assert capfd.readouterr().err == ""
    check_memory(SimpleNamespace(transport_shape=(100_000, 1000)), "noise-aware")
    line = "periscopy: 100000 pixels x 1000 patches need about 3.1 GB of memory\n"
    assert capfd.readouterr().err == line


# -- light that bounces --------------------------------------------------------------------------

ROOM = ("transport", "bright_room", *TINY)
TO_RECONSTRUCT = ("reconstruct", "y.npy", "--scene", "bright_room", *TINY, "--out", "r")


@pytest.fixture
def rough(monkeypatch):
    """Trace few paths: the rest of the light is as good for what is tested here."""
    trace = partial(bounced.render_bounced_light, target=0.1)
    monkeypatch.setattr(bounced_transport, "render_bounced_light", trace)


@pytest.fixture
def photograph(tmp_path):
    y = np.random.default_rng(0).uniform(0.9, 1, (24, 24, 3))
    np.save(tmp_path / "y.npy", y)


@pytest.mark.usefixtures("rough")
def test_matrix_with_bounces_is_written_read_and_told(succeeds, tmp_path):
    said = succeeds(*ROOM, "--bounces", "2", *OUT)
    assert "wrote A.npy 576x20 and A.json" in said and "wrote A.bounced.npz" in said
    scenario = ps.load_scenario("bright_room", (4, 5), {"resolution": "24"})
    direct = ps.render_transport(scenario, samples=4)
    expected = bounced_transport.add_bounces(scenario, direct, 2)
    A = read_transport(tmp_path / "A.npy", scenario, 2)
    assert np.asarray(A).tobytes() == np.asarray(expected).tobytes()
    f = np.random.default_rng(1).random((20, 3))
    # BLAS rounds by where in memory a matrix begins.
    np.testing.assert_allclose(A @ f, expected @ f, rtol=1e-14)
    record = json.loads((tmp_path / "A.json").read_text())
    assert record["bounces"] == "2"
    assert record["bounced_relative_error"] == expected.bounced.relative_error


@pytest.mark.usefixtures("rough", "photograph", "few_lights")
def test_reconstruction_by_all_bounces_says_so(succeeds, tmp_path):
    succeeds(*TO_RECONSTRUCT, "--bounces", "all")
    assert json.loads((tmp_path / "r" / "summary.json").read_text())["bounces"] == "all"


@pytest.mark.usefixtures("rough", "photograph")
def test_matrix_of_other_bounces_is_refused(succeeds, refused, tmp_path):
    succeeds(*ROOM, "--bounces", "all", *OUT)
    given = (*TO_RECONSTRUCT, "--transport", "A.npy")
    line = refused(*given)
    assert line.startswith("A.npy: was rendered by --bounces all, and --bounces direct is asked")
    assert "--bounces 3 is asked for" in refused(*given, "--bounces", "3")
    file = tmp_path / "A.bounced.npz"
    whole = file.read_bytes()
    file.write_bytes(whole[:-30])
    assert "A.bounced.npz: " in refused(*given, "--bounces", "all")
    file.unlink()
    assert "A.bounced.npz: " in refused(*given, "--bounces", "all")
    file.write_bytes(whole)
    (tmp_path / "A.json").unlink()
    assert "A.json: is missing" in refused(*given)
    succeeds(*ROOM, *OUT)
    assert not file.exists()  # it was of the matrix that stood there before
    line = refused(*given, "--bounces", "all")
    assert line.startswith("A.npy: was rendered by --bounces direct, and --bounces all is asked")


@pytest.mark.usefixtures("rough", "photograph")
def test_files_of_two_matrices_are_not_taken_for_one(succeeds, refused, tmp_path):
    given = (*TO_RECONSTRUCT, "--transport", "A.npy", "--bounces", "all")
    succeeds(*ROOM, "--bounces", "all", *OUT)
    matrix, light = ((tmp_path / name).read_bytes() for name in ("A.npy", "A.bounced.npz"))
    succeeds(*ROOM, "--bounces", "all", "--seed", "1", *OUT)
    other = (tmp_path / "A.npy").read_bytes()
    (tmp_path / "A.npy").write_bytes(matrix)
    assert "A.npy: is of another matrix than A.json" in refused(*given)
    (tmp_path / "A.npy").write_bytes(other)
    (tmp_path / "A.bounced.npz").write_bytes(light)
    assert "A.bounced.npz: is of another matrix than A.npy" in refused(*given)


@pytest.mark.usefixtures("rough", "few_lights")
def test_analysis_is_of_the_bounces_asked_for(succeeds, tmp_path):
    found = {}
    for bounces in ("direct", "all"):
        succeeds("analyze", "bright_room", *TINY, "--bounces", bounces, "--out", bounces)
        found[bounces] = json.loads((tmp_path / bounces / "summary.json").read_text())
        assert found[bounces]["bounces"] == bounces
    assert found["all"]["condition_A"] != found["direct"]["condition_A"]


@pytest.mark.parametrize("command", [ROOM, TO_RECONSTRUCT], ids=["transport", "reconstruct"])
@pytest.mark.parametrize("text", ["0", "-1", "2.5", "none", "", "1e3", "10000000"])
def test_bounces_that_are_none_are_refused(command, text, refused):
    line = refused(*command, "--bounces", text, *(OUT if command is ROOM else ()))
    assert line == f"--bounces '{text}': give direct, all, or a whole number from 1 on"


@pytest.mark.usefixtures("rough")
def test_interrupt_while_light_is_traced_leaves_nothing(periscopy, monkeypatch, tmp_path):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(bounced_transport, "render_bounced_light", interrupt)
    assert periscopy(*ROOM, "--bounces", "all", *OUT).code == 130
    assert list(tmp_path.iterdir()) == []
