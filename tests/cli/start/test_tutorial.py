"""The tutorial's files in a folder of the user's."""

import shlex

import pytest

from periscopy_sim.shipped import scenes_folder

SHIPPED = scenes_folder() / "tutorial"


def contents(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.parametrize("name", ["measurements.yaml", "truth/scene.xml"])
def test_no_file_is_overwritten(name, refused, tmp_path):
    file = tmp_path / "mine" / name
    file.parent.mkdir(parents=True)
    file.write_text("my own")
    line = refused("tutorial", "--out", "mine")
    assert line == f"mine/{name} exists already and stays; name another folder"


@pytest.mark.usefixtures("jit")
def test_command_that_it_begins_with_makes_the_scene(succeeds, tmp_path):
    (hint,) = succeeds("tutorial", "--out", "mine").splitlines()[1:]
    name, *arguments = shlex.split(hint.removeprefix("begin with: "))
    assert name == "periscopy"
    succeeds(*arguments)
    assert (tmp_path / "lab.xml").is_file()
