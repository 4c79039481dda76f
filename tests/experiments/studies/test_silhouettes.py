"""The study of silhouettes: what is compared, what the search is given, and what is kept."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import periscopy_sim as ps
from experiments.studies.kept_case import read_case, write_case
from experiments.studies.silhouettes import __main__ as study
from experiments.studies.silhouettes import outcome as outcomes
from experiments.studies.silhouettes import report, subjects
from experiments.studies.silhouettes.outcome import Outcome, shared, shifted
from periscopy_sim.calibration.silhouette.plane import mask_plane
from tests.calibration.silhouette.conftest import FLAG, silhouette

HIDDEN = (4, 5)
ROWS = tuple("".join("#" if cell else "." for cell in row) for row in FLAG)
HOLED = FLAG & (np.arange(8) % 3 > 0)
MASK = subjects.Mask("a flag", ROWS, "mushroom", 0.5, HIDDEN)


def outcome(name="a flag", *, opaque=FLAG, shift=(0.0, 0.0), sbr=0.5, placed=True, doubts=()):
    """A case whose mask and images are as told."""
    rng = np.random.default_rng(len(name))
    truth = rng.uniform(0, 1, (*HIDDEN, 3))
    return Outcome(
        name=name, image="mushroom", sbr=sbr, opaque=opaque, seen=np.ones_like(opaque),
        outline=subjects.drawn(replace(MASK, shift=shift)), sides=[0.08, 0.08], truth=truth,
        placed=placed, found_image=truth + 0.1, flat_image=truth + 0.05, true_image=truth + 0.01,
        unexplained=2e-3, unexplained_open=5e-2, overdispersion=1.1, told=50.0,
        doubts=list(doubts), seconds=9.0,
    )  # fmt: skip


@pytest.fixture
def subject(tmp_path):
    """A flag before noise: its scenes are real ones."""
    searched, true = subjects.write_scenes(MASK, tmp_path / "scenes")
    random = np.random.default_rng(1)
    sought = subjects.Sought(
        random.random((126, 126, 3)), None, searched, "plate", HIDDEN, FLAG.shape
    )
    truth = subjects.Truth(random.random((*HIDDEN, 3)), True, true, subjects.drawn(MASK))
    return subjects.Subject(MASK.name, MASK.image, MASK.sbr, sought, truth)


def test_masks_share_what_is_opaque_in_both_of_what_is_in_either():
    one, other = np.zeros((2, 6, 6), bool)
    one[1:3, 1:4], other[2:5, 1:4] = True, True  # 6 and 9 cells, 3 of them in both
    agreed = shared(one, other)
    assert agreed.standing == pytest.approx(3 / 12)
    assert agreed.shifted == pytest.approx(6 / 9)
    assert (agreed.down, agreed.right) == (1, 0)
    assert shared(other, other) == outcomes.Shared(1, 1, 0, 0)
    assert shared(one, ~one).standing == 0
    assert shared(~one & one, ~one & one).standing == 1


@pytest.mark.parametrize(("down", "right"), [(0, 1), (2, -1), (-1, 0)])
def test_a_shift_is_told_and_what_comes_in_is_open(down, right):
    moved = shifted(FLAG, down, right)
    assert not shifted(np.ones((3, 3), bool), 1, 0)[0].any()
    there, back = shared(FLAG, moved), shared(moved, FLAG)
    assert there.shifted == 1
    assert back.shifted == pytest.approx(np.sum(moved) / np.sum(FLAG))  # what left does not return
    assert (there.down, there.right) == (down, right)
    assert (back.down, back.right) == (-down, -right)


def test_a_mask_between_cells_is_compared_with_the_cells_that_it_half_covers():
    between, beyond = outcome(shift=(0.4, 0.0)), outcome(shift=(0.6, 0.0))
    assert between.shared.standing == 1
    assert not np.array_equal(between.outline, outcome().outline)
    assert beyond.shared.standing == shared(FLAG, shifted(FLAG, 0, 1)).standing < 1
    assert (beyond.shared.shifted, beyond.shared.down, beyond.shared.right) == (1, 0, 1)


def test_each_mask_is_of_16_cells_a_side_within_an_open_border():
    for mask in subjects.MASKS:
        cells = subjects.cells_of(mask)
        assert cells.shape == (16, 16)
        assert not cells[0].any() and not cells[:, [0, -1]].any()
        assert ps.find_image(mask.image).is_file()


def test_the_search_sees_a_square_where_the_mask_stands(tmp_path):
    mask = replace(subjects.MASKS[0], shift=(0.4, 0.3))
    searched, true = (ps.load_scenario(s, HIDDEN) for s in subjects.write_scenes(mask, tmp_path))
    assert [o.name for o in searched.occluders] == [o.name for o in true.occluders] == ["plate"]
    plane = mask_plane(searched, "plate")
    assert plane.sides == pytest.approx((0.08, 0.08), abs=1e-6)
    assert len(searched.occluders[0].faces) == 2
    rows, offsets = plane.rows_of_projection()
    places = 16 * (true.occluders[0].vertices @ rows.T + offsets)
    middles = places.reshape(-1, 4, 3).mean(axis=1)
    # Across and down, as one sees it who faces the wall.
    expected = np.argwhere(subjects.cells_of(mask))[:, ::-1] + 0.5 + mask.shift
    np.testing.assert_allclose(middles[:, :2], expected, atol=1e-3)
    np.testing.assert_allclose(middles[:, 2], 0, atol=1e-4)


def test_an_outline_is_what_parts_cover_of_the_rectangle(tmp_path):
    searched = ps.load_scenario(subjects.write_scenes(MASK, tmp_path)[0], HIDDEN)
    plate = ps.load_scenario(ps.find_scene("plate"), HIDDEN)
    found = subjects.outline(plate, searched, "plate", FLAG.shape)
    # The plate, 75 mm wide and high and 1 mm thick, stands on the square's lower edge.
    assert found.mean() == pytest.approx(0.075**2 / 0.08**2, abs=0.02)
    assert not found[:4].any() and found[-4:, 16:-16].all()


def test_an_outline_covers_the_cells_that_it_covers_by_half():
    outline = np.zeros((8, 8), bool)
    outline[:4, :2] = outline[4:, :1] = True
    covered = outcomes.cells_covered(outline, (2, 2))
    np.testing.assert_array_equal(covered, [[True, False], [False, False]])
    np.testing.assert_array_equal(outcomes.cells_covered(subjects.drawn(MASK), FLAG.shape), FLAG)


def test_a_chair_that_is_not_flat_is_known_as_a_box(tmp_path, monkeypatch):
    monkeypatch.setattr(subjects, "RAYS", (1, 1))
    monkeypatch.setattr(subjects, "PATHS", 4)
    lit = []

    def ambient(names, scene, *_):
        lit.append(scene)
        return {names[0]: np.ones((126, 126, 3))}

    monkeypatch.setattr(subjects, "ambient_photographs", ambient)
    subject = subjects.solid_chair(tmp_path)
    assert [scene.path for scene in lit] == [subject.truth.scene]
    (box,) = ps.load_scenario(subject.sought.scene, (1, 1)).occluders
    assert box.name == subject.sought.shape
    true = ps.load_scenario(subject.truth.scene, (1, 1)).occluders
    lowest, highest = (
        f(np.concatenate([part.vertices for part in true]), axis=0) for f in (np.min, np.max)
    )
    assert (box.vertices.min(axis=0) < lowest + 1e-6).all()
    assert (box.vertices.max(axis=0) > highest - 1e-6).all()


def test_light_is_rendered_once(tmp_path, monkeypatch):
    monkeypatch.setattr(subjects, "RAYS", (1, 1))
    monkeypatch.setattr(subjects, "PATHS", 4)
    monkeypatch.setattr(
        subjects, "ambient_photographs", lambda names, *_: {names[0]: np.ones((126, 126, 3))}
    )
    first = subjects.rendered(MASK, tmp_path)
    assert first.sought.cells == FLAG.shape and first.truth.placed
    assert first.sought.scene != first.truth.scene
    A = ps.analytic_transport(ps.load_scenario(first.truth.scene, HIDDEN))
    straight = (A @ first.truth.image.reshape(-1, 3)).reshape(126, 126, 3)
    light = 3 * first.sought.photograph.mean() - 2  # at an SBR of 0.5, before light of mean 1
    assert light == pytest.approx(1, abs=0.01)
    lit = first.sought.photograph - first.sought.photograph.min()
    assert np.corrcoef(lit.ravel(), straight.ravel())[0, 1] > 0.95
    monkeypatch.setattr(ps, "render_photograph", None)
    again = subjects.rendered(MASK, tmp_path)
    np.testing.assert_array_equal(again.sought.photograph, first.sought.photograph)
    with pytest.raises(TypeError):
        subjects.rendered(replace(MASK, image="bars"), tmp_path)


@pytest.mark.thorough
def test_a_case_is_run_once_and_then_kept(subject, tmp_path, monkeypatch, capsys):
    def found(photograph, scene, hidden, shape, cells, **_):
        assert photograph is subject.sought.photograph and scene == subject.sought.scene
        assert (hidden, shape, cells) == (HIDDEN, "plate", FLAG.shape)
        plane = mask_plane(ps.load_scenario(scene, HIDDEN), shape)
        return replace(silhouette(plane, HOLED), name=shape)

    def image(path, _):
        """With an error that tells how much of the square is opaque."""
        return subject.truth.image + area(path)

    def area(path):
        (mask,) = ps.load_scenario(path, HIDDEN).occluders
        edges = np.diff(mask.vertices[mask.faces], axis=1)
        return np.linalg.norm(np.cross(*np.moveaxis(edges, 1, 0)), axis=1).sum() / 2

    monkeypatch.setattr(ps, "recover_silhouette", found)
    monkeypatch.setattr(outcomes, "recovered", image)
    assert study.run({"a flag": lambda: subject}, tmp_path) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"a flag: {shared(HOLED, FLAG).standing:.2f} of its cells shared")
    (case,) = json.loads((tmp_path / "silhouettes.json").read_text("utf-8"))["cases"]
    exact = ps.psnr(subject.truth.image + area(subject.truth.scene), subject.truth.image)
    assert case["psnr_true"] == case["psnr_flat"] == pytest.approx(exact, abs=1e-3)
    assert case["psnr_found"] > exact + 1  # less is opaque
    assert "not trusted: 0 of the search's 0 starts" in said
    # `found` has gone: the case is read.
    monkeypatch.setattr(ps, "recover_silhouette", None)
    assert study.run({"a flag": lambda: subject}, tmp_path) == 0
    assert capsys.readouterr().out == said
    brighter = replace(subject, sought=replace(subject.sought, photograph=np.ones((126, 126, 3))))
    assert study.run({"a flag": lambda: brighter, "b": lambda: subject}, tmp_path) == 1
    out = capsys.readouterr().out
    assert out.startswith("a flag: failed") and "of its cells shared" in out  # the other stays
    assert json.loads((tmp_path / "silhouettes.json").read_text("utf-8"))["cases"] == [case]


def test_an_outcome_is_read_as_it_was_written(tmp_path):
    made = outcome(sbr=None, placed=False, doubts=["odd"])
    write_case(made, tmp_path / "one.npz", "here")
    assert read_case(Outcome, tmp_path / "one.npz", "elsewhere") is None
    assert read_case(Outcome, tmp_path / "none.npz", "here") is None
    read = read_case(Outcome, tmp_path / "one.npz", "here")
    assert report.numbers_of(read) == report.numbers_of(made)
    np.testing.assert_array_equal(read.outline, made.outline)
    assert read.opaque.dtype == bool and not read.trusted


@pytest.mark.thorough
def test_the_report_holds_every_case(tmp_path):
    cases = [
        outcome(),
        outcome("half a flag", opaque=HOLED),
        outcome("real", sbr=None, placed=False, opaque=HOLED, doubts=["it is odd"]),
    ]
    section = report.write_report(tmp_path, cases, "what it is", {"seed": "0"})
    with (tmp_path / "silhouettes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    held = json.loads((tmp_path / "silhouettes.json").read_text("utf-8"))
    assert [row["case"] for row in rows] == [case["case"] for case in held["cases"]]
    assert held["cases"][0]["shared"] == 1 and held["cases"][2]["psnr_found"] is None
    assert held["cases"][0]["registered_true"] > held["cases"][0]["registered_found"]
    assert "it is odd" in (tmp_path / "index.html").read_text("utf-8")
    assert [claim.measured for claim in section.claims[::2]] == ["1 of 2", "1 of 2"]
    assert section.claims[2].reason == "half a flag"
    assert section.pictures[0].file == tmp_path / "silhouettes.png"
    for name in ("silhouettes", "silhouettes_rendered"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_what_is_no_photograph_is_refused_in_one_line(tmp_path):
    app = typer.Typer()
    app.command()(study.main)
    bare, damaged = tmp_path / "bare.npz", tmp_path / "damaged.npz"
    photograph = np.random.default_rng(0).random((144, 144, 3))
    np.savez(bare, photograph=photograph)
    damaged.write_bytes(b"PK no archive")
    np.savez(objects := tmp_path / "objects.npz", photograph=photograph, shown=np.array([{}]))
    for options, said in (
        (["--real", tmp_path / "none.npz"], "none.npz"),
        (["--real", bare], "bare.npz"),
        (["--other", damaged], "damaged.npz"),
        (["--other", bare], "has no array 'shown'"),
        (["--other", objects], "'shown' cannot be read as numbers"),
    ):
        result = CliRunner().invoke(app, ["--out", str(tmp_path / "out"), *map(str, options)])
        assert result.exit_code == 2 and said in result.output, result.output
        assert result.output.count("\n") == 1
    assert not (tmp_path / "out" / "index.html").exists()
