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


def fake(name, measured="1"):
    claims = [Claim("what", "1", measured, Verdict.AGREES)]
    return lambda _: Section(name, f"Title of {name}", claims=claims)


def breaking(_):
    raise ValueError("no light at all")


@pytest.fixture
def without_the_scene(monkeypatch):
    monkeypatch.setattr(pages, "_record", lambda *_: {"numpy": "2.0"})
    monkeypatch.setattr(pages, "_digest", lambda setting: f"code, {setting.real}")


def page_of(functions, **more):
    names = tuple(dict.fromkeys(("fig3", "fig8", *functions)))
    return Page(
        "experiments.paper", "A title", "An introduction.", names, "paper", functions, **more
    )


def command(page, *arguments):
    app = Typer()
    app.command()(page.command())
    return CliRunner().invoke(app, list(map(str, arguments)))


def measured(out):
    claims = json.loads((out / "claims.json").read_text("utf-8"))["claims"]
    return [(claim["section"], claim["measured"]) for claim in claims]


@pytest.mark.parametrize(
    "page", [PAPER, BEYOND, BENCHMARKS, PUBLISHED], ids=lambda page: page.package
)
def test_every_experiment_of_a_page_can_be_loaded(page):
    for name in page.names:
        assert callable(page.load(name)), name


@pytest.mark.usefixtures("without_the_scene")
def test_an_experiment_that_breaks_fails_alone(tmp_path):
    page = page_of({"fig3": breaking, "fig8": fake("fig8")})
    assert command(page, "--out", tmp_path).exit_code == 1
    text = (tmp_path / "index.html").read_text("utf-8")
    assert "no light at all" in text and "Title of fig8" in text and "An introduction." in text
    claims = json.loads((tmp_path / "claims.json").read_text("utf-8"))
    assert list(claims["failed"]) == ["fig3"] and claims["provenance"] == {"numpy": "2.0"}
    assert command(page, "--out", tmp_path, "--only", "fig8").exit_code == 0


@pytest.mark.usefixtures("without_the_scene")
def test_a_run_makes_what_was_not_made_from_the_same_inputs(tmp_path):
    def stopped(_):
        raise KeyboardInterrupt

    old = {"fig3": fake("fig3", "old"), "fig8": stopped}
    with pytest.raises(KeyboardInterrupt):
        pages.run(page_of(old), list(old), Setting(tmp_path))
    assert "Title of fig3" in (tmp_path / "index.html").read_text("utf-8")
    new = page_of({"fig3": fake("fig3", "new"), "fig8": fake("fig8", "new")})
    assert pages.run(new, ["fig3", "fig8"], Setting(tmp_path)) == 0
    assert measured(tmp_path) == [("fig3", "old"), ("fig8", "new")]
    pages.run(new, ["fig3"], Setting(tmp_path, real=Path("another.npz")))
    assert measured(tmp_path) == [("fig3", "new"), ("fig8", "new")]


@pytest.mark.parametrize(
    ("options", "offender"),
    [
        (["--only", "fig3,fig11"], "fig11"),
        (["--only", "fig3,,fig8"], "''"),
        (["--real", "missing.npz"], "missing.npz"),
    ],
)
def test_a_users_mistake_is_one_line_before_any_work(tmp_path, monkeypatch, options, offender):
    monkeypatch.setattr(Page, "load", lambda *_: pytest.fail("work began"))
    result = command(PAPER, "--out", tmp_path / "run", *options)
    assert result.exit_code == 2
    assert offender in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()
