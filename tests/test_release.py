import importlib.util
import io
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / "release" / "check.py"

pytestmark = pytest.mark.skipif(not SCRIPT.is_file(), reason="no sdist holds the script")


@pytest.fixture(scope="module")
def check():
    spec = importlib.util.spec_from_file_location("release_check", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def distributions(check, tmp_path):
    """Write a wheel and an sdist that hold what they must, and more."""

    def write(*more, without=()):
        wheel, sdist = tmp_path / "p-1.whl", tmp_path / "p-1.tar.gz"
        with zipfile.ZipFile(wheel, "w") as archive:
            for name in {*check.IN_WHEEL, *more} - set(without):
                archive.writestr(name, "")
        with tarfile.open(sdist, "w:gz") as archive:
            for name in {*check.IN_SDIST, *more} - set(without):
                archive.addfile(tarfile.TarInfo(f"p-1/{name}"), io.BytesIO())
        return wheel, sdist

    return write


def test_what_is_asked_of_distributions_lies_here(check):
    for name in (*check.IN_WHEEL, *check.IN_SDIST):
        beside = name.replace("periscopy_sim/scenes/", "scenes/")
        assert (ROOT / beside).is_file(), name


def test_whole_distributions_pass(check, distributions, capsys):
    check.check_contents(*distributions())
    assert "p-1.whl" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "without", "words"),
    [
        ((), ("periscopy_sim/py.typed",), "wheel: lacks"),
        ((), ("CHANGELOG.md",), "sdist: lacks"),
        (("periscopy_sim/__pycache__/a.pyc",), (), "wheel: .* holds"),
        (("tests/test_a.py",), (), "wheel: holds"),
    ],
)
def test_what_is_missing_or_strange_is_told(check, distributions, more, without, words):
    with pytest.raises(SystemExit, match=words):
        check.check_contents(*distributions(*more, without=without))
