import json
from pathlib import Path

import pytest
from typer import Typer
from typer.testing import CliRunner

from experiments import page as pages
from experiments.benchmarks.__main__ import PAGE as BENCHMARKS
from experiments.beyond.__main__ import PAGE as BEYOND
from experiments.page import Page
from experiments.paper.__main__ import PAGE as PAPER
from experiments.published.__main__ import PAGE as PUBLISHED
from experiments.report import Claim, Section, Verdict
from experiments.setting import Setting

RECORD = {"numpy": "2.0"}


def fake(name, measured="1"):
    def run(setting):
        assert setting.seed == 0
        return Section(
            name, f"Title of {name}", claims=[Claim("what", "1", measured, Verdict.AGREES)]
        )

    return run


def breaking(_):
    raise ValueError("no light at all")


@pytest.fixture(autouse=True)
def without_the_scene(monkeypatch):
    monkeypatch.setattr(pages, "_record", lambda *_: RECORD)
    monkeypatch.setattr(pages, "_digest", lambda setting: f"code, {setting.real}")


def page_of(functions, **more):
    names = tuple(dict.fromkeys(("fig3", "fig8", *functions)))
    return Page(
        "experiments.paper", "A title", "An introduction.", names, "paper", functions, **more
    )


def run(out, functions, **how):
    return pages.run(page_of(functions), list(functions), Setting(out), **how)


def command(page, *arguments):
    app = Typer()
    app.command()(page.command())
    return CliRunner().invoke(app, list(arguments))


def measured(out):
    claims = json.loads((out / "claims.json").read_text("utf-8"))["claims"]
    return [(claim["section"], claim["measured"]) for claim in claims]


def test_a_run_leaves_a_page_claims_and_each_section(tmp_path, capsys):
    assert run(tmp_path, {"fig3": fake("fig3"), "fig8": fake("fig8")}) == 0
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "Title of fig3" in page and "Title of fig8" in page
    assert "A title" in page and "An introduction." in page
    claims = json.loads((tmp_path / "claims.json").read_text("utf-8"))
    expected = {"what": "what", "stated": "1", "measured": "1", "verdict": "agrees", "reason": ""}
    assert claims["claims"] == [{"section": name, **expected} for name in ("fig3", "fig8")]
    assert claims["failed"] == {} and claims["provenance"] == RECORD
    assert sorted(file.name for file in (tmp_path / "sections").iterdir()) == [
        "fig3.json",
        "fig8.json",
    ]
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["fig3", "fig8"]
    assert all(line.endswith(" s of processors' time)") for line in lines)


def test_one_section_is_renewed_and_the_others_stay(tmp_path):
    run(tmp_path, {"fig8": fake("fig8", "old"), "fig3": fake("fig3", "kept")})
    run(tmp_path, {"fig8": fake("fig8", "new")}, anew=True)
    assert measured(tmp_path) == [("fig3", "kept"), ("fig8", "new")]
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "<td>kept</td>" in page and "<td>old</td>" not in page


def test_an_experiment_that_breaks_is_told_and_the_others_go_on(tmp_path, capsys):
    assert run(tmp_path, {"fig3": breaking, "fig8": fake("fig8")}) == 1
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "Failed: ValueError: no light at all" in page and "Title of fig8" in page
    claims = json.loads((tmp_path / "claims.json").read_text("utf-8"))
    assert claims["failed"] == {"fig3": "ValueError: no light at all"}
    said = capsys.readouterr()
    assert "fig3: ValueError: no light at all (failed)" in said.out
    assert "Traceback" in said.err


def test_a_stopped_run_goes_on_with_what_was_not_done(tmp_path, capsys):
    def stopped(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, {"fig3": fake("fig3"), "fig8": stopped})
    assert "Title of fig3" in (tmp_path / "index.html").read_text("utf-8")
    capsys.readouterr()
    run(tmp_path, {"fig3": breaking, "fig8": fake("fig8")})
    assert "fig3: Title of fig3 (kept)" in capsys.readouterr().out
    assert measured(tmp_path) == [("fig3", "1"), ("fig8", "1")]


def test_a_section_of_other_inputs_or_that_failed_is_made_again(tmp_path):
    run(tmp_path, {"fig3": fake("fig3", "old"), "fig8": breaking})
    functions = {"fig3": fake("fig3", "new"), "fig8": fake("fig8", "new")}
    run(tmp_path, functions)
    assert measured(tmp_path) == [("fig3", "old"), ("fig8", "new")]
    pages.run(page_of(functions), ["fig3"], Setting(tmp_path, real=Path("another.npz")))
    assert measured(tmp_path) == [("fig3", "new"), ("fig8", "new")]


@pytest.mark.parametrize(
    "page", [PAPER, BEYOND, BENCHMARKS, PUBLISHED], ids=lambda page: page.package
)
def test_every_experiment_of_a_page_can_be_loaded(page):
    for name in page.names:
        assert callable(page.load(name)), name


@pytest.mark.parametrize("names", ["fig3,fig11", "fig11", "fig3,,fig8"])
def test_an_unknown_name_is_refused_in_one_line(tmp_path, names):
    result = command(PAPER, "--out", str(tmp_path / "run"), "--only", names)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: no experiment '")
    assert "table1" in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_the_exit_code_tells_of_a_failure(tmp_path):
    page = page_of({"fig3": fake("fig3"), "fig8": breaking})
    assert command(page, "--out", str(tmp_path), "--only", "fig3").exit_code == 0
    assert command(page, "--out", str(tmp_path), "--only", "fig3,fig8").exit_code == 1


def test_what_is_named_runs_anew_and_alone(tmp_path):
    functions = {"fig3": fake("fig3", "old"), "fig8": fake("fig8", "old")}
    assert command(page_of(functions, on_demand=("fig8",)), "--out", str(tmp_path)).exit_code == 0
    assert measured(tmp_path) == [("fig3", "old")]
    page = page_of({"fig3": fake("fig3", "new"), "fig8": fake("fig8", "new")})
    command(page, "--out", str(tmp_path), "--only", "fig8")
    assert measured(tmp_path) == [("fig3", "old"), ("fig8", "new")]
    command(page, "--out", str(tmp_path), "--only", "fig3")
    assert measured(tmp_path) == [("fig3", "new"), ("fig8", "new")]


def test_an_unreadable_photograph_is_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr(Page, "load", lambda *_: pytest.fail("work began"))
    missing = tmp_path / "missing.npz"
    result = command(PAPER, "--out", str(tmp_path / "run"), "--real", str(missing))
    assert result.exit_code == 2
    assert "missing.npz" in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_other_code_or_another_photograph_is_another_digest(tmp_path, monkeypatch):
    monkeypatch.undo()
    real = tmp_path / "real.npz"
    setting = Setting(tmp_path)
    first = pages._digest(setting)
    assert pages._digest(Setting(tmp_path / "elsewhere")) == first
    setting.real = real
    setting.__dict__["measured"] = None  # it need not be a photograph
    real.write_bytes(b"1")
    second = pages._digest(setting)
    real.write_bytes(b"2")
    assert len({first, second, pages._digest(setting)}) == 3
