import hashlib
import pickle
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cloudpickle
import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.hidden import Hidden
from periscopy_sim.methods import METHODS, checked_images, find_method, fit_method, source_sha256
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.photograph import ColourMatrix, Photograph

RNG = np.random.default_rng(8)
A = RNG.uniform(0.1, 1, (48, 6))
B = RNG.uniform(0.1, 1, (48, 2))
TRUTH = RNG.uniform(0.1, 1, (2, 3, 3))
MINE = """
import numpy as np

class Mine:
    def __init__(self, scenario, A, B):
        self.scenario, self.A, self.B = scenario, A, B

    def reconstruct(self, photograph):
        return np.full((*self.scenario.hidden_shape, 3), photograph.mean())

class Outer:
    Inner = Mine

def pair(scenario, A):
    return Mine(scenario, A, None)

def deaf(scenario, A, B):
    return 3

class Masked(Mine):
    def __init__(self, scenario, A, B, mask=None):
        super().__init__(scenario, A, B)
        self.mask = mask

def masked(scenario, A, B, *, mask=None):
    return Masked(scenario, A, B, mask)

class Seen(Mine):
    def reconstruct(self, photograph):
        self.seen = photograph
        return np.ones((*self.scenario.hidden_shape, photograph.shape[2]))

constant = 4
"""


@dataclass(frozen=True)
class Scene:
    photograph_shape: tuple = (8, 6)
    hidden_shape: tuple = (2, 3)
    hidden: tuple = (2, 3)
    channel_gain: tuple = (1.2, 1.0, 0.8)


def image_by(method, photograph):
    return checked_images(method.reconstruct(photograph), Hidden.of((2, 3)), 3)["monitor"]


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MINE)
    return tmp_path / "mine.py"


def photograph(background=0.0):
    gain = np.array(Scene.channel_gain)
    y = A @ TRUTH.reshape(6, 3) * gain + background * B.sum(axis=1, keepdims=True)
    return y.reshape(8, 6, 3)


def test_wall_colour_and_backgrounds_reach_the_methods_that_model_them():
    for name, background, recovered in [
        ("preconditioned", 0, True),
        ("preconditioned", 5, True),
        ("pseudoinverse", 0, True),
        ("pseudoinverse", 5, False),
    ]:
        method = fit_method(name, Scene(), A, B)
        method.tv_weight, method.repair_threshold = 0, np.inf
        image = image_by(method, photograph(background))
        assert np.allclose(image, TRUTH, rtol=1e-3) == recovered, (name, background)


MASK = np.random.default_rng(6).random((8, 6)) > 0.2


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize("name", ["mine.py:Masked", "mine.py:masked"])
def test_own_method_that_takes_a_mask_is_given_it(name):
    fitted = fit_method(name, Scene(), A, B, Photograph.of(photograph(), mask=MASK))
    assert (fitted.method.mask == MASK).all()
    assert fit_method(name, Scene(), A, B).method.mask is None


@pytest.mark.usefixtures("mine")
def test_own_method_that_takes_no_mask_is_fitted_without_and_the_user_told():
    with pytest.warns(UserWarning, match=r"'mine\.py:Mine' takes no keyword mask: .* as black"):
        given = Photograph.of(photograph() + 1, mask=MASK)
        fitted = fit_method("mine.py:Mine", Scene(), A, B, given)
    assert fitted.method.A is A
    black = np.where(MASK[..., None], given.values, 0)
    np.testing.assert_allclose(fitted.reconstruct(given), black.mean())


@pytest.mark.usefixtures("mine")
def test_own_method_sees_the_monitors_primaries():
    colours = ColourMatrix(np.array([[0.7, 0.2, 0], [0.2, 1, 0.3], [0, 0.3, 1], [0.4, 0.4, 0.4]]))
    method = find_method("mine.py:Seen")(Scene(channel_gain=None), A, B)
    given = Photograph.of(colours.mix(photograph()), colour_matrix=colours)
    method.reconstruct(given)
    np.testing.assert_allclose(method.fitted_to(given).method.seen, photograph())
    method.reconstruct(photograph()[..., :1])  # and grey
    assert method.method.seen.shape == (8, 6, 1)


def test_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(PeriscopyError) as error:
        find_method("magic")
    for name in METHODS:
        assert name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "name", ["mine.py:Mine", "./mine.py:Mine", "mine:Mine", "mine.py:Outer.Inner", "{0}:Mine"]
)
def test_own_method_is_found_in_a_file_or_a_module(name, mine, monkeypatch):
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    name = name.format(mine)
    path = list(sys.path)
    method = fit_method(name, Scene(), A, B)
    assert sys.path == path
    own = method.method
    assert own.scenario == Scene() and own.A is A and own.B is B
    assert np.allclose(image_by(method, np.full((8, 6, 3), 2.0)), 2)
    assert source_sha256(name) == hashlib.sha256(mine.read_bytes()).hexdigest()


def test_own_method_of_a_file_travels_to_a_process_without_the_file(mine):
    method = fit_method("mine.py:Mine", Scene(), A, B)
    method._scenario = method.method.scenario = None  # which the other process does not know
    content = cloudpickle.dumps(method)
    mine.unlink()
    code = "import pickle, sys; print(pickle.load(sys.stdin.buffer).method.A.shape)"
    ended = subprocess.run(
        [sys.executable, "-c", code], input=content, capture_output=True, cwd=mine.parent
    )
    assert ended.stdout == b"(48, 6)\n", ended.stderr
    assert pickle.loads(content).method.B.shape == B.shape


@pytest.mark.parametrize(
    ("name", "message"),
    [
        *((name, name) for name in ("builtins:__import__", "builtins:dict", "os:_exit")),
        ("mine", "no method 'mine'"),
        ("mine.py:", "no method 'mine.py:'"),
        ("none.py:Mine", "FileNotFoundError"),
        ("no_such_module:Mine", "No module named 'no_such_module'"),
        ("mine.py:Other", "'Other'"),
        ("mine.py:pair", "three arguments (scenario, A, B)"),
        ("mine.py:constant", "three arguments (scenario, A, B)"),
        ("mine.py:deaf", "makes an object of type int, which has no"),
        ("broken.py:Mine", "cannot be imported: SyntaxError"),
        ("raising.py:Mine", "cannot be imported: KeyError: 'no'"),
        ("leaving.py:Mine", "cannot be imported: SystemExit: 3"),
    ],
)
def test_what_is_no_method_is_refused_by_one_line(name, message, mine):
    (mine.parent / "broken.py").write_text("class Mine(\n")
    (mine.parent / "raising.py").write_text("raise KeyError('no')\n")
    (mine.parent / "leaving.py").write_text("import sys\nsys.exit(3)\n")
    with pytest.raises(PeriscopyError) as error:
        fit_method(name, Scene(), A, B)
    assert message in str(error.value)
    # What failed half way leaves nothing that a second try would take for it.
    with pytest.raises(PeriscopyError):
        fit_method(name, Scene(), A, B)


BROKEN = """
import sys
import numpy as np
from periscopy_sim.errors import SceneError

class Lost:
    def __init__(self, scenario, A, B):
        raise KeyError("no")

class Deep:
    def __init__(self, scenario, A, B):
        self.inverse = self.invert(A)
    def invert(self, A):
        return np.linalg.inv(A)  # A is not square

class Refusing:
    def __init__(self, scenario, A, B):
        raise SceneError("not this one")

class Leaving:
    def __init__(self, scenario, A, B):
        sys.exit(0)
"""


@pytest.mark.parametrize(
    ("name", "message", "line"),
    [
        ("Lost", "KeyError: 'no'", 'KeyError("no")'),
        ("Deep", "LinAlgError: Last 2 dimensions of the array must be square", "linalg.inv"),
        ("Refusing", "SceneError: not this one", 'SceneError("not this one")'),
        ("Leaving", "SystemExit: 0", "sys.exit(0)"),
    ],
)
@pytest.mark.parametrize("place", ["deep/mine.py", "mine_that_breaks"])
def test_whatever_an_own_method_raises_while_it_is_fitted_names_it_and_its_line(
    name, message, line, place, mine
):
    (mine.parent / "deep").mkdir()
    for file in ("deep/mine.py", "mine_that_breaks.py"):
        (mine.parent / file).write_text(BROKEN)
    number = next(n for n, text in enumerate(BROKEN.splitlines(), 1) if line in text)
    file = "mine.py" if place.endswith(".py") else f"{place}.py"
    with pytest.raises(PeriscopyError) as caught:
        fit_method(f"{place}:{name}", Scene(), A, B)
    said = str(caught.value)
    assert said.startswith(f"method '{place}:{name}' cannot be fitted: {message}")
    assert said.endswith(f"({file}:{number})")


def test_a_scene_that_a_built_in_method_cannot_take_is_not_the_error_of_an_own_one():
    with pytest.raises(InputError, match=r"^A .* full column rank"):
        fit_method("pseudoinverse", Scene(), np.ones((48, 6)), B)


def test_the_documentations_own_method_is_blind_to_ambient_light(mine):
    page = (Path(__file__).parents[1] / "docs" / "own_method.md").read_text("utf-8")
    code = page.split("```python file=my_method.py\n")[1].split("```")[0]
    (mine.parent / "my_method.py").write_text(code)
    method = fit_method("my_method.py:MyMethod", Scene(), A, B)
    for background in (0, 5):
        assert np.allclose(image_by(method, photograph(background)), TRUTH, rtol=1e-5)
    # With noise: the hidden part of the joint least squares problem.
    y = photograph(5) + RNG.normal(0, 0.1, (8, 6, 3))
    joint = np.linalg.lstsq(np.hstack([A, B]), y.reshape(48, 3), rcond=None)[0][:6]
    expected = (joint / Scene.channel_gain).reshape(2, 3, 3)
    assert np.allclose(image_by(method, y), expected, rtol=1e-5, atol=1e-6)


class Returning:
    def __init__(self, image):
        self.image = image

    def reconstruct(self, _):
        return self.image


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.ones((3, 2, 3)), r"shape \(3, 2, 3\) instead of .* \(2, 3, 3\)"),
        (None, "NoneType"),
        (
            np.array([*[np.nan] * 3, *range(15)]).reshape(2, 3, 3),
            "returned NaN or infinite values, 3 of 18",
        ),
        (TRUTH * 1j, "complex128"),
        (np.full((2, 3, 3), 1e300), "infinite values, 18 of 18"),
    ],
)
def test_image_that_breaks_the_promise_is_refused(image, message):
    with pytest.raises(ValueError, match=message):
        image_by(Returning(image), photograph())


@pytest.mark.parametrize(
    ("method", "name", "successor"),
    [
        ("iterative", "IterativePeriscope", "noise-aware|ps.NoiseAware"),
        ("unrolled", "Learned", "experiments/learned/unrolled.py:Unrolled"),
    ],
)
def test_methods_that_are_gone_name_what_takes_their_place(method, name, successor):
    with pytest.raises(PeriscopyError, match=successor):
        find_method(method)
    with pytest.raises(AttributeError, match=successor):
        getattr(ps, name)
