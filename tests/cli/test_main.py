import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from periscopy_sim.cli.fitting.transport_matrix import AskedTransport

from periscopy_sim import cli
from periscopy_sim.cli import inputs
from periscopy_sim.errors import PeriscopyError

TINY = ("-D", "resolution=24", "--hidden", "4x5", "--samples", "4")
TRANSPORT = ("transport", "chair", *TINY, "--out", "A.npy")
OPTIONS = {
    "demo": {"--out", "--hidden", "--resolution", "--image", "--seed"},
    "doctor": set(),
    "tutorial": {"--out"},
    "draw": {"SCENE", "--out", "-D"},
    "lab": {"[MEASUREMENTS.yaml]", "--out", "--example"},
    "view": {
        *("SCENE", "[PHOTO]", "--hidden", "--out", "--image", "--ambient", "--sbr", "--snr"),
        *("--method", "--mask", "--host", "--port", "-D"),
    },
    "transport": {"SCENE", "--hidden", "--out", "--samples", "--model", "--seed", "-D"},
    "photograph": {
        *("SCENE", "IMAGE", "--out", "--hidden", "--samples"),
        *("--ambient", "--sbr", "--snr", "--seed", "-D"),
        *("--electrons", "--read-noise", "--full-well", "--bits", "--frames"),
    },
    "prepare": {
        *("PHOTO...", "--scene", "--out", "--black", "--dark", "--flat", "--white", "--exposures"),
        *("--points", "--tags", "--mask", "--bin", "--hidden", "-D"),
    },
    "ambient": {"--scene", "--out", "[NAME]...", "--target", "--seed", "-D"},
    "reconstruct": {
        *("PHOTO", "--scene", "--hidden", "--out", "--method", "--samples", "--model"),
        *("--transport", "--tv-weight", "--repair-threshold", "--rank-tolerance", "--truth"),
        *("--seed", "-D"),
    },
    "analyze": {
        *("SCENE", "--hidden", "--out", "--samples", "--model"),
        *("--rank-tolerance", "--seed", "-D"),
    },
    "design": {
        *("SCENE", "--vary", "--hidden", "--out", "--grid", "--draws", "--by", "--equal", "--sbr"),
        *("--snr", "--images", "--samples", "--model", "--light-model", "--seed", "-D"),
    },
    "calibrate": {
        *("PHOTO", "--scene", "--hidden", "--free", "--out", "--samples", "--mask"),
        *("--seed", "-D"),
    },
    "dataset": {"make", "info", "verify", "export"},
    "sweep": {
        *("SCENE", "--hidden", "--out", "--photograph", "--truth", "--hidden-image", "--sbr"),
        *("--ambient", "--flips", "--methods", "--snr", "--seeds", "--scheduler", "--samples"),
        *("--seed", "-D"),
    },
    "video": {
        *("FRAMES", "--scene", "--hidden", "--out", "--coupling", "--temporal-weight"),
        *("--l1-weight", "--samples", "--model", "--transport", "--tv-weight"),
        *("--repair-threshold", "--rank-tolerance", "--truth", "--rate", "--batch"),
        *("--seed", "-D"),
    },
}


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


@pytest.mark.parametrize("command", OPTIONS)
def test_every_option_is_explained(command):
    parameters = typer.main.get_command(cli.app).commands[command].params
    assert [parameter.name for parameter in parameters if not parameter.help] == []


@pytest.mark.parametrize("command", OPTIONS)
def test_every_option_names_what_it_takes_or_its_choices(command, succeeds):
    commands = [command, *(OPTIONS[command] if command == "dataset" else ())]
    for name in commands:
        shown = succeeds(*dict.fromkeys([command, name]), "--help").partition("Options:")[2]
        forms = [line.split("  ")[1] for line in shown.splitlines() if line.startswith("  --")]
        taken = {form.partition(" ")[2] for form in forms}
        assert not {form for form in taken if "<" in form and "|" not in form}, name


@pytest.mark.parametrize(
    ("words", "completions"),
    [("rec", {"reconstruct"}), ("video y.npy --method ", {"noise-aware", "preconditioned"})],
)
def test_shell_completes_commands_and_methods(words, completions):
    line = f"periscopy {words}"
    ended = run(
        *("-m", "periscopy_sim"),
        _PERISCOPY_COMPLETE="complete_bash",
        COMP_WORDS=line,
        COMP_CWORD=str(len(line.split(" ")) - 1),
    )
    assert set(ended.stdout.split()) == completions and ended.stderr == ""


INTERRUPT = "exec('signal.raise_signal(signal.SIGINT)')"
BEFORE = f"""
class Interrupts:
    def find_spec(self, name, *_):
        if name == "periscopy_sim.cli":
            {INTERRUPT}

sys.meta_path.insert(0, Interrupts())
"""
WITHIN = f"""
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
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr == "periscopy: error: interrupted; nothing was written\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device here")
@pytest.mark.parametrize("arguments", [("--help",), ("--version",), ("dataset", "--example")])
def test_output_that_is_full_is_one_line(arguments):
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "periscopy_sim", *arguments],
            stdout=full, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr == (
        "periscopy: error: cannot print: No space left on device; free some space\n"
    )


def test_help_needs_no_renderer_and_no_solver():
    """They take four times as long to import as the rest."""
    heavy = {"mitsuba", "numba", "scipy", "matplotlib"}
    code = f"import sys; from periscopy_sim import cli; sys.exit(bool({heavy} & set(sys.modules)))"
    assert run("-c", code).returncode == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("paint",), "No such command 'paint'."),
        (("--loud",), "No such option: --loud"),
        ((*TRANSPORT, "--loud"), "No such option: --loud"),
        ((*TRANSPORT, "plate"), "plate"),
        (("transport", *TINY, "--out", "A.npy"), "Missing argument 'SCENE'."),
        (("transport", "chair", *TINY), "Missing option '--out'."),
        (("transport", "chair", "--out", "A.npy"), "Missing option '--hidden'."),
        (("reconstruct", "y.npy", *TINY, "--out", "r"), "Missing option '--scene'."),
        (("photograph", "chair", "--out", "y.exr"), "Missing argument 'IMAGE'."),
        ((*TRANSPORT, "--model", "guessed"), "'rendered', 'analytic'"),
        ((*TRANSPORT, "--samples", "0"), "'--samples'"),
        ((*TRANSPORT, "--samples", "many"), "'--samples'"),
        ((*TRANSPORT, "--samples", "2000000000"), "'--samples'"),
        ((*TRANSPORT, "--seed", "-1"), "'--seed'"),
        ((*TRANSPORT, "--seed", str(2**32)), "'--seed'"),
    ],
)
def test_what_the_parser_refuses_is_one_line_with_a_way_on(arguments, message, refused):
    line = refused(*arguments)
    assert message in line
    command = f"{arguments[0]} " if arguments[0] in OPTIONS else ""
    assert line.endswith(f" Try 'periscopy {command}--help'.")


def test_lack_of_memory_is_one_line(monkeypatch, refused):
    monkeypatch.setattr(inputs, "load", failing(MemoryError("Unable to allocate 26.8 GiB")))
    assert "not enough memory: Unable to allocate 26.8 GiB" in refused(*TRANSPORT)


def test_missing_extra_is_named_before_anything_is_rendered(monkeypatch, refused, tmp_path):
    monkeypatch.setitem(sys.modules, "xarray", None)
    monkeypatch.setitem(sys.modules, "zarr", None)
    monkeypatch.setattr(AskedTransport, "matrix", lambda *_: pytest.fail("rendered"))
    sweep = ("sweep", "chair", *TINY, "--hidden-image", "bars", "--ambient", "overcast")
    message = refused(*sweep, "--out", str(tmp_path / "sweep"))
    assert "pip install -e '.[sweep]'" in message
    assert not (tmp_path / "sweep").exists()


def test_error_that_no_user_can_mend_keeps_its_traceback(monkeypatch, periscopy, tmp_path):
    monkeypatch.setattr(inputs, "load", failing(RuntimeError("a defect")))
    with pytest.raises(RuntimeError, match="a defect"):
        periscopy(*TRANSPORT)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        TRANSPORT,
        ("photograph", "chair", "mushroom", *TINY, "--out", "new/y.exr"),
        ("reconstruct", "y.npy", "--scene", "chair", *TINY, "--out", "new/r"),
        ("calibrate", "y.npy", "--scene", "chair", *TINY, "--out", "new/found.xml"),
        ("analyze", "chair", *TINY, "--out", "r"),
        ("ambient", "overcast", "--scene", "chair", "--out", "new/b"),
        ("demo", "--out", "new/r"),
        ("sweep", "chair", *TINY, "--hidden-image", "bars", "--out", "new/r"),
    ],
)
@pytest.mark.usefixtures("jit")
def test_interrupt_ends_with_130_and_writes_nothing(arguments, monkeypatch, periscopy, tmp_path):
    monkeypatch.setattr(inputs, "load", failing(KeyboardInterrupt))
    outcome = periscopy(*arguments)
    assert outcome.code == 130
    assert outcome.err == "periscopy: error: interrupted; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [NameError, PeriscopyError])
def test_interrupt_of_which_another_error_is_made_still_interrupts(
    error, monkeypatch, periscopy, tmp_path
):
    def load(*_):
        try:
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as interrupt:
                raise ImportError from interrupt  # as an extension does that is being imported
        except ImportError:
            raise error("name '_drjit_ext' is not defined")  # noqa: B904  nobody says from what

    monkeypatch.setattr(inputs, "load", load)
    outcome = periscopy(*TRANSPORT)
    assert outcome.code == 130
    assert outcome.err == "periscopy: error: interrupted; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


def test_module_runs_as_the_command_does():
    ended = run("-m", "periscopy_sim", "--help")
    assert ended.returncode == 0
    assert set(OPTIONS) <= set(ended.stdout.split()) and ended.stderr == ""
    ended = run("-m", "periscopy_sim", "transport", "chair")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == (
        "periscopy: error: Missing option '--hidden'. Its form: ROWSxCOLUMNS. "
        "Try 'periscopy transport --help'.\n"
    )


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
    assert (process.returncode, complaint) == (1, b"periscopy: rendering the transport matrix\n")


@pytest.mark.usefixtures("jit")
def test_name_that_the_terminal_cannot_encode_is_printed_all_the_same(tmp_path):
    ended = subprocess.run(
        [sys.executable, "-m", "periscopy_sim", *TRANSPORT[:-1], "é.npy"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
    )
    assert ended.returncode == 0
    assert ended.stderr == b"periscopy: rendering the transport matrix\n"
    assert ended.stdout == b"wrote \\xe9.npy 576x20 and \\xe9.json\n"
    assert {path.name for path in tmp_path.iterdir()} == {"é.npy", "é.json"}


def test_version_is_shown(succeeds):
    assert succeeds("--version").startswith("periscopy_sim ")


def test_termination_leaves_nothing_half_written(tmp_path):
    run = (
        "import os, signal, sys\n"
        "from periscopy_sim import cli\n"
        "from periscopy_sim.cli import inputs\n"
        "inputs.load = lambda *_: os.kill(os.getpid(), signal.SIGTERM)\n"
        "sys.argv = ['periscopy', 'analyze', 'chair', '--hidden', '4x5', '--out', 'out']\n"
        "cli.main()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", run], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 130
    assert list(tmp_path.iterdir()) == []


LOST_INTERRUPT = """
import ctypes, os, signal, time
import periscopy_sim.cli as cli

@ctypes.CFUNCTYPE(None)
def callback():
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):
        pass

def app(*_, **__):
    callback()  # ctypes cannot raise through compiled code
    time.sleep(20)
    print("finished")

cli.app = app
cli.main()
"""
