import json

import pytest
from typer import Typer
from typer.testing import CliRunner

from experiments.paper import __main__ as paper
from experiments.setting import Setting
from periscopy_sim.figures.report import Claim, Section, Verdict

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


def reproduce(out, found):
    return paper.reproduce(list(found), Setting(out), RECORD, find=found.__getitem__)


def command(*arguments):
    app = Typer()
    app.command()(paper.main)
    return CliRunner().invoke(app, list(arguments))


def test_a_run_leaves_a_page_claims_and_each_section(tmp_path, capsys):
    assert reproduce(tmp_path, {"fig3": fake("fig3"), "fig8": fake("fig8")}) == 0
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "Title of fig3" in page and "Title of fig8" in page
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
    assert all(line.endswith(" s)") for line in lines)


def test_one_section_is_renewed_and_the_others_stay(tmp_path):
    reproduce(tmp_path, {"fig8": fake("fig8", "old"), "fig3": fake("fig3", "kept")})
    reproduce(tmp_path, {"fig8": fake("fig8", "new")})
    claims = json.loads((tmp_path / "claims.json").read_text("utf-8"))["claims"]
    assert [(claim["section"], claim["measured"]) for claim in claims] == [
        ("fig3", "kept"),
        ("fig8", "new"),
    ]
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "<td>kept</td>" in page and "<td>old</td>" not in page


def test_an_experiment_that_breaks_is_told_and_the_others_go_on(tmp_path, capsys):
    found = {"fig3": breaking, "fig8": fake("fig8")}
    assert reproduce(tmp_path, found) == 1
    page = (tmp_path / "index.html").read_text("utf-8")
    assert "Failed: ValueError: no light at all" in page and "Title of fig8" in page
    claims = json.loads((tmp_path / "claims.json").read_text("utf-8"))
    assert claims["failed"] == {"fig3": "ValueError: no light at all"}
    said = capsys.readouterr()
    assert "fig3: ValueError: no light at all (failed)" in said.out
    assert "Traceback" in said.err


def test_an_interrupted_run_keeps_what_was_done(tmp_path):
    def interrupted(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path, {"fig3": fake("fig3"), "fig8": interrupted})
    assert "Title of fig3" in (tmp_path / "index.html").read_text("utf-8")
    assert (tmp_path / "sections" / "fig3.json").is_file()


@pytest.mark.parametrize("name", paper.EXPERIMENTS)
def test_every_experiment_of_the_page_can_be_loaded(name):
    assert callable(paper.load(name))


@pytest.mark.parametrize("names", ["fig3,fig11", "fig11", "fig3,,fig8"])
def test_an_unknown_name_is_refused_in_one_line(tmp_path, names):
    result = command("--out", str(tmp_path / "run"), "--only", names)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: no experiment '")
    assert "table1" in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_the_exit_code_tells_of_a_failure(tmp_path, monkeypatch):
    monkeypatch.setattr(paper, "load", {"fig3": fake("fig3"), "fig8": breaking}.__getitem__)
    monkeypatch.setattr(paper, "_record", lambda _: RECORD)
    assert command("--out", str(tmp_path), "--only", "fig3").exit_code == 0
    assert command("--out", str(tmp_path), "--only", "fig3,fig8").exit_code == 1


def test_an_unreadable_photograph_is_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(paper, "reproduce", lambda *_, **__: pytest.fail("work began"))
    missing = tmp_path / "missing.npz"
    result = command("--out", str(tmp_path / "run"), "--real", str(missing))
    assert result.exit_code == 2
    assert "missing.npz" in result.stderr and result.stderr.count("\n") == 1
