import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer

import periscopy_sim as ps
from periscopy_sim import cli

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
SWEEP = ("sweep", "chair", *TINY, "--hidden-image", "bars")
TRANSPORT = ("transport", "chair", *TINY, "--out", "A.npy")
PARSER = typer.main.get_command(cli.app)


def failing(error):
    def fail(*_, **__):
        raise error

    return fail


def run(*command, **environment):
    return subprocess.run(
        [sys.executable, *command],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_help_lists_every_command_in_whole_lines(succeeds, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    listed = succeeds("--help").partition("─ Start ")[2].splitlines()
    names = {line.split()[1] for line in listed if line.startswith("│")}
    assert names == set(cli.MODULES) == set(PARSER.list_commands(None))
    assert not any("..." in line for line in listed)
    assert succeeds() == succeeds("--help")
    assert succeeds("--version").startswith("periscopy_sim ")


def test_help_shows_every_option_with_its_form(succeeds):
    for command in sorted({*cli.MODULES} - {"dataset"}):
        shown = succeeds(command, "--help")
        for parameter in PARSER.get_command(None, command).params:
            assert parameter.help, parameter.name
            if not getattr(parameter, "hidden", False):
                is_option = parameter.param_type_name == "option"
                assert (parameter.opts[0] if is_option else parameter.metavar) in shown


def test_shell_completes_methods():
    line = {"COMP_WORDS": "periscopy video y.npy --method ", "COMP_CWORD": "4"}
    ended = run("-m", "periscopy_sim", _PERISCOPY_COMPLETE="complete_bash", **line)
    assert set(ended.stdout.split()) == {"noise-aware", "preconditioned"} and ended.stderr == ""


def test_what_a_user_can_fix_is_one_short_line(refused):
    for arguments, offender in [
        (("paint",), "'paint'"),
        (("reconstuct", "y.npy"), "did you mean 'reconstruct'?"),
        (("ambient", "overcst", "--scene", "chair", "--out", "a"), "did you mean 'overcast'?"),
        ((*SWEEP, "--ambient", "overcst", "--out", "s"), "did you mean 'overcast'?"),
        (("transport", "chiar", *TINY, "--out", "A.npy"), "did you mean 'chair'?"),
        (("transport", "chair", "--out", "A.npy"), "'--hidden'"),
        ((*TRANSPORT, "--model", "guessed"), "'guessed'"),
        (("reconstruct", "y.npy", *TINY, "--tv-weight", "nan"), "'--tv-weight'"),
        ((*TRANSPORT, "-D", "occluder_dx=nan"), "occluder_dx"),
        (("transport", "x" * 5000, *TINY, "--out", "A.npy"), "xxx"),
        ((*TRANSPORT[:-1], "y" * 5000 + ".npy"), "yyy"),
        ((*TRANSPORT[:-1], "s3://bucket/A.npy"), "s3:/bucket/A.npy: it is a URL"),
        ((*SWEEP, "--ambient", "all,gs://y.exr", "--out", "s"), "gs:/y.exr: is a URL"),
        (("transport", os.fsdecode(b"\xe9.xml"), *TINY, "--out", "A.npy"), "udce9"),
    ]:
        line = refused(*arguments)
        assert offender in line and len(line) < 1200


@pytest.mark.usefixtures("few_lights")
def test_error_of_numpy_is_no_mistake_of_the_user(monkeypatch, periscopy, tmp_path, photographs):
    np.save("y.npy", photographs[0])
    monkeypatch.setattr("numpy.linalg.cholesky", failing(ValueError("of NumPy")))
    command = ("reconstruct", "y.npy", "--scene", "chair", *TINY[:4], "--method", "preconditioned",
               "--model", "analytic")  # fmt: skip
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    ended = periscopy(*command, "--out", "out")
    assert (ended.code, ended.out, ended.err.count("\n")) == (1, "", 1)
    (trace,) = tmp_path.glob("*.txt")
    assert str(trace) in ended.err and "periscopy doctor" in ended.err
    assert "preconditioned.py" in trace.read_text() and not Path("out").exists()


@pytest.mark.parametrize(
    ("lacking", "extras", "options"),
    [
        ("websockets cv2", "live,tags", "watch . --scene plate --hidden 3x4 --tags t.csv"),
        ("cv2 rawpy", "raw,tags", "prepare wall.dng --scene plate --tags t.csv --out p.exr"),
        ("rawpy", "raw", "reconstruct wall.dng --scene plate --hidden 3x4 --out o"),
    ],
)  # fmt: skip
def test_all_missing_extras_are_named_at_once(lacking, extras, options, monkeypatch, refused):
    for name in ("wall.dng", "t.csv"):
        Path(name).touch()
    for library in lacking.split():
        monkeypatch.setitem(sys.modules, library, None)
    line = refused(*options.split())
    assert f"'.[{extras}]'" in line and all(library in line for library in lacking.split())


def test_missing_file_is_named_before_anything_is_rendered(monkeypatch, refused):
    monkeypatch.setattr(ps.Scenario, "transport", lambda *_, **__: pytest.fail("rendered"))
    np.save("y.npy", np.random.default_rng(0).uniform(1, 2, (16, 16, 3)))
    scene = "--hidden", "3x4", "-D", "resolution=16", "--out", "out"
    for options in [
        *(f"reconstruct y.npy --scene plate --{each}" for each in
          ("mask", "monitor-off", "transport", "colour-matrix", "truth", "light-model")),
        *(f"sweep plate --truth bars --photograph {each}" for each in
          ("y.npy --mask", "y.npy --light-model")),
        "sweep plate --hidden-image", "view plate --image",
    ]:  # fmt: skip
        assert "none.npy" in refused(*options.split(), "none.npy", *scene)


def test_place_that_cannot_be_written_is_refused_before_anything_is_read(refused):
    Path("file").write_text("kept")
    Path("y.npy").write_bytes(b"")  # no photograph
    for command in (
        ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--out", "file/new"),
        ("demo", "--out", "file"),
        ("photograph", "chair", "bars", "--out", "file.png"),
    ):
        assert "file" in refused(*command)


INTERRUPT = "exec('signal.raise_signal(signal.SIGINT)')"
BEFORE = f"""
class Interrupts:
    def find_spec(self, name, *_):
        if name == "periscopy_sim.cli":
            {INTERRUPT}

sys.meta_path.insert(0, Interrupts())
"""
WITHIN = f"""
import periscopy_sim as ps
from periscopy_sim import cli
cli.app = lambda *_, **__: {INTERRUPT}
"""


@pytest.mark.parametrize("moment", [BEFORE, WITHIN], ids=["before", "within"])
def test_interrupt_is_one_line_and_130_even_in_a_string_of_code(moment, monkeypatch, tmp_path):
    # In such a string, as `dataclass` runs them, Python takes any interrupt for unhandled, and
    # with -m it would end by the signal. So once in ten times when one came during an import.
    (tmp_path / "interrupted.py").write_text(
        f"import signal, sys\n{moment}\nfrom periscopy_sim.__main__ import main\nmain()\n"
    )
    monkeypatch.chdir(tmp_path)
    ended = run("-m", "interrupted")
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (130, "", 1)


@pytest.mark.parametrize(
    ("event", "code", "left"),
    [("os.kill(os.getpid(), signal.SIGTERM)", 130, 0), ("np.ones(2) + np.ones(3)", 1, 1)],
)
def test_what_ends_a_command_leaves_nothing_half_written(event, code, left, tmp_path):
    script = (
        "import os, signal, sys\n"
        "import numpy as np\n"
        "from periscopy_sim import cli\n"
        "from periscopy_sim.analytic import area_transport\n"
        "area_transport.PIXEL_POINTS = 24\n"
        f"np.linalg.cholesky = lambda *_, **__: {event}\n"
        "sys.argv = ['periscopy', 'analyze', 'chair', '--hidden', '4x5', '--out', 'out',\n"
        "            '-D', 'resolution=24', '--model', 'analytic']\n"
        "cli.main()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "TMPDIR": str(tmp_path)}, cwd=tmp_path, capture_output=True,
    )  # fmt: skip
    assert ended.returncode == code and b"Traceback" not in ended.stderr
    assert ended.stderr.count(b"periscopy: error: ") == 1  # whatever the option parser makes of it
    traces = [path.read_text() for path in tmp_path.iterdir()]
    assert len(traces) == left and all("ValueError" in trace for trace in traces)


@pytest.mark.usefixtures("jit")
def test_closed_pipe_ends_the_command_without_complaint(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-m", "periscopy_sim", *TRANSPORT],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        process.stdout.close()
        complaint = process.stderr.read()
    assert process.returncode == 1 and b"Error" not in complaint
