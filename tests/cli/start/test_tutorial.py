"""The tutorial's files in a folder of the user's."""

import shlex

import pytest


@pytest.mark.parametrize("name", ["measurements.yaml", "truth/scene.xml"])
def test_no_file_is_overwritten(name, refused, tmp_path):
    file = tmp_path / "mine" / name
    file.parent.mkdir(parents=True)
    file.write_text("my own")
    assert f"mine/{name}" in refused("tutorial", "--out", "mine")


@pytest.mark.usefixtures("jit")
def test_command_that_it_begins_with_makes_the_scene(succeeds, tmp_path):
    (hint,) = succeeds("tutorial", "--out", "mine").splitlines()[1:]
    name, *arguments = shlex.split(hint.removeprefix("begin with: "))
    assert name == "periscopy"
    succeeds(*arguments)
    assert (tmp_path / "lab.xml").is_file()
