from string import ascii_lowercase

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.markers import CARETDOWN
from scipy import stats

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.figures.style import OKABE_ITO
from periscopy_sim.figures.sweeps import draw_sweep, labelled, latex_of
from tests.scenes.pictures import covers, read

xr = pytest.importorskip("xarray")

SBRS, SIZES = [0.1, 1.0, 10.0], ["9x11", "15x18"]


def results(seed=3):
    """Errors of two methods over sizes, places, SBRs and draws, as a sweep gives them."""
    labels = {
        "algorithm": [r"$\\frac$", "second"], "hidden": SIZES, "image": ["p"],
        "background": [f"b{i}" for i in range(5)], "sbr": SBRS, "seed": [0, 1],
    }  # fmt: skip
    errors = np.random.default_rng(seed).uniform(0.01, 0.1, tuple(map(len, labels.values())))
    errors[1, ..., 2, :] = np.nan  # the second failed at the last ratio
    data = xr.Dataset({"mean_squared_error": (tuple(labels), errors)}, labels)
    data["mean_squared_error"].attrs["units"] = "1"
    data["failure"] = data["mean_squared_error"].isnull().astype(str).str.replace("False", "")
    return data


def test_each_panel_shows_means_and_confidence_intervals_of_each_method(tmp_path, saved):
    metadata = {"Source": "chair.xml, seed 3", "Comment": "λ = 1"}
    given = results()
    draw_sweep(
        tmp_path / "a.png", given.isel(sbr=[2, 0, 1]), metric="mean_squared_error", width=7.2,
        metadata=metadata,
    )  # fmt: skip
    text, pixels = read(tmp_path / "a.png")
    assert metadata.items() <= text.items()
    assert [ax.get_title(loc="left")[0] for ax in saved[0].axes] == [*ascii_lowercase[:2]]
    for ax, size in zip(saved[0].axes, SIZES, strict=True):
        assert size in ax.get_title(loc="left")
        for k, count in enumerate((3, 2)):
            line, band = ax.lines[k], ax.collections[k].get_paths()[0].vertices
            places = given["mean_squared_error"].sel(hidden=size).isel(algorithm=k).mean("seed")
            own = places.squeeze("image").values[:, :count]
            assert to_rgb(line.get_color()) == to_rgb(OKABE_ITO[k])
            np.testing.assert_allclose(line.get_ydata()[:count], own.mean(axis=0))
            first = band[np.isclose(band[:, 0], 0.1), 1]
            interval = stats.t.interval(0.95, 4, own[:, 0].mean(), stats.sem(own[:, 0]))
            np.testing.assert_allclose([first.min(), first.max()], interval)
    assert covers(pixels, 255 * np.array(to_rgb(OKABE_ITO[0]))).sum() > 500
    assert "over 5 places" in saved[0].get_supxlabel()


def test_panels_a_hundred_times_apart_show_their_lines(tmp_path, saved):
    given = results()
    scale = xr.DataArray([1.0, 0.01], {"hidden": SIZES}, ["hidden"])
    given["mean_squared_error"] = given["mean_squared_error"] * scale
    draw_sweep(tmp_path / "a.png", given, metric="mean_squared_error", panels="hidden")
    low, high = saved[0].axes[0].get_ylim()
    means = np.concatenate([line.get_ydata() for ax in saved[0].axes for line in ax.lines])
    means = means[np.isfinite(means)]
    assert len(means) == 10 and low < means.min() < 2e-3 and high > means.max()


def test_any_axis_is_drawn_over_and_what_is_held_is_said(tmp_path, saved):
    metric = "mean_squared_error"
    given = results().assign_coords(sbr=[0.1, 0.316228, 10])
    draw_sweep(tmp_path / "a.pdf", given, metric=metric, over="hidden", panels="background")
    assert [ax.axison for ax in saved[0].axes] == 5 * [True] + [False]
    assert [tick.get_text() for tick in saved[0].axes[0].get_xticklabels()] == SIZES
    assert "SBR = 0.316228 (one of 3)" in saved[0].get_supxlabel().replace("\n", " ")
    with pytest.raises(PeriscopyError, match="sbr"):
        draw_sweep(tmp_path / "b.png", results(), metric=metric, over="sbrr")
    with pytest.raises(PeriscopyError, match="mean_squared_error"):
        draw_sweep(tmp_path / "b.png", results(), metric="mean_error")


def test_captions_name_what_is_held_and_which_method_failed(tmp_path, saved):
    given = results().isel(hidden=[0]).assign_attrs(held=["hidden"])
    given["failure"][0, 0, 0, :3, 0] = "lost"
    given["mean_squared_error"] = given["mean_squared_error"].where(given["failure"] == "")
    caption = draw_sweep(tmp_path / "a.png", given, metric="mean_squared_error")
    assert f"hidden = {SIZES[0]}" in caption and "10 of second failed" in caption
    (marked,) = (line for line in saved[0].axes[0].lines if line.get_mfc() == "white")
    (cut,) = (line for line in saved[0].axes[0].lines if line.get_marker() == CARETDOWN)
    assert marked.get_xdata().tolist() == cut.get_xdata().tolist() == [0.1]
    assert cut.get_ydata() == pytest.approx(saved[0].axes[0].get_ylim()[0])
    latex = latex_of(given, "mean_squared_error", "tab:a")
    assert f"hidden = {SIZES[0]}" in latex and latex.count(" (4 of 10)") == 1


def test_labels_take_the_place_of_names(tmp_path, saved):
    labels = {"second": "ours", "sbr": "light", "mean_squared_error": "error_1"}
    named = labelled(results(), "mean_squared_error", labels)
    draw_sweep(tmp_path / "a.png", named, metric="mean_squared_error", over="sbr")
    assert saved[0].axes[-1].get_xlabel() == "light"
    assert "ours" in [text.get_text() for text in saved[0].legends[0].get_texts()]
    latex = latex_of(named, "mean_squared_error", "tab:fig_1")
    assert r"\label{tab:fig_1}" in latex and r"error\_1" in latex and " ours " in latex
    for wrong in ({"sbrr": "light"}, {"second": "ours", r"$\\frac$": "ours"}):
        with pytest.raises(PeriscopyError, match=r"sbr|two methods"):
            labelled(results(), "mean_squared_error", wrong)
