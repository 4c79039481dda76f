import shutil
import time
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import periscopy_sim as ps
from experiments.benchmarks import live
from periscopy_sim.scenario import load_scenario

pytest.importorskip("websockets")
pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(not any(map(shutil.which, live.CHROMIUM)), reason="needs Chromium"),
]
PATIENCE = live.PATIENCE
HOSTILE = '<iframe srcdoc="<script>f()</script>"></iframe></div><img src=x onerror=f()> &lt;b&gt;'
"""What an id, a name, a value or a message may hold."""


@pytest.fixture(scope="module")
def session(opened):
    scenario = load_scenario("chair", (29, 36))
    light = ps.point_light_backgrounds(scenario)[:, 100].reshape(126, 126, 1) * np.ones(3)
    return opened(scenario, "lamp", light, lambda _: HOSTILE)


@pytest.fixture(scope="module")
def browser():
    with live.chromium() as opened:
        yield opened


@pytest.fixture(scope="module")
def page(session, browser):
    """The page of one person, and what it asked the network for."""
    requests = []
    opened = live.visit(session, browser, requests)
    opened.requests = requests
    return opened


def wait_for_full(session, holds=lambda pictures: True, since=0.0):  # noqa: ARG005
    """Wait for the full pictures of what is set, and return when they came, and them."""
    end = time.monotonic() + PATIENCE
    while True:
        when, pictures = session.shown[-1] if session.shown else (0.0, None)
        if when > since and pictures and not pictures.is_coarse and holds(pictures):
            return when, pictures
        assert time.monotonic() < end
        time.sleep(0.02)


def test_dragging_a_handle_moves_the_scene_and_its_pictures(session, page):
    before = wait_for_full(session)[1]
    count = len(session.shown)
    live.drag(session, page, "chair", seconds=4.0)
    released = time.monotonic()
    after = wait_for_full(session, since=released)[1]
    assert any(each.is_coarse for _, each in session.shown[count:])
    moved = session.choice.values["occluder_dx"]
    assert 0.02 < moved < 0.06 and session.choice.values["occluder_dz"] == 0
    assert after.choice.values["occluder_dx"] == pytest.approx(moved)
    assert np.abs(after.photograph.values - before.photograph.values).max() > 0.02


def test_what_is_chosen_changes_the_pictures(session, page):
    page.get_by_label("Ambient light").select_option("none")
    wait_for_full(session, lambda each: not each.choice.place)
    page.get_by_label("Ambient light").select_option("lamp")
    _, lit = wait_for_full(session, lambda each: each.choice.place)
    page.evaluate(live.COUNT)
    page.get_by_label("SBR").select_option("0.05")
    _, dim = wait_for_full(session, lambda each: each.choice.sbr == 0.05)
    assert dim.photograph.values.std() < 0.5 * lit.photograph.values.std()
    assert dim.psnr < lit.psnr
    assert page.evaluate("window.pictures") > 0
    page.get_by_label("SNR (dB)").first.fill("10")  # steps of 1 dB from 20 dB
    wait_for_full(session, lambda each: each.choice.snr == 30)
    typed = page.get_by_label("SNR (dB)").last
    typed.fill("")
    typed.blur()
    assert typed.input_value() == "30"  # neither 0 nor the least


def test_a_phone_shows_the_scene_and_every_control_whole(page):
    before = page.viewport_size
    page.set_viewport_size({"width": 390, "height": 844})
    edges = """() => [...document.querySelectorAll("canvas, input, select, button")]
        .map((each) => each.getBoundingClientRect()).filter((box) => box.height)
        .map(({left, right}) => [left, right])"""
    left, right = np.transpose(page.evaluate(edges))
    page.set_viewport_size(before)
    assert (left >= 0).all() and (right <= 390).all() and (right - left > 40).all()


def test_undo_takes_back_what_a_key_did_to_a_slider(session, page):
    slider, field = (page.get_by_label("occluder_dy").nth(k) for k in (0, 1))
    before = slider.input_value(), field.input_value()
    slider.press("ArrowRight")
    assert slider.input_value() != before[0] and field.input_value() != before[1]
    slider.press("Control+z")
    page.wait_for_timeout(1000)
    assert session.choice.values["occluder_dy"] == 0
    assert (slider.input_value(), field.input_value()) == before


def test_a_bookmark_with_a_fragment_opens_the_page(session, browser):
    opened = browser.new_page()
    opened.goto(f"{session.gate.url}#x")
    opened.locator("#panels figure").first.wait_for(timeout=1000 * PATIENCE)
    opened.close()


def test_keys_turn_the_view(page):
    before = page.evaluate("camera.azimuth")
    page.locator("#marks").press("ArrowLeft")
    assert page.evaluate("camera.azimuth") != before


CONTRAST = """() => {
    const luminance = (colour) => colour.match(/[\\d.]+/g).slice(0, 3)
        .map((x) => x / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4))
        .reduce((sum, x, i) => sum + x * [0.2126, 0.7152, 0.0722][i], 0);
    const ground = (each) => {
        const colour = getComputedStyle(each).backgroundColor;
        return colour === "rgba(0, 0, 0, 0)" ? ground(each.parentElement) : colour;
    };
    return [...document.querySelectorAll("span, div, summary, select, input[type=number], button")]
        .filter((each) => each.checkVisibility())
        .map((each) => [getComputedStyle(each).color, ground(each)].map(luminance))
        .map(([a, b]) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05));
}"""
"""Contrast of each text of the page, by WCAG 2."""


def test_both_themes_are_legible_and_keep_the_photographs_values(session, page):
    wait_for_full(session, lambda each: each.choice == session.choice)
    looks = {}
    for scheme in "light", "dark":
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(1000)
        assert min(page.evaluate(CONTRAST)) >= 4.5
        corners = page.evaluate("[[0, 0], [2, 2]].map(([i, j]) => state.photograph.grid[i][j])")
        x, y = page.evaluate("onScreen", np.mean(corners, axis=0).tolist())
        view = np.asarray(Image.open(BytesIO(page.locator("#scene").screenshot())).convert("RGB"))
        looks[scheme] = view[5, 5], view[round(y), round(x)]
    assert looks["light"][0].min() == 255 and looks["dark"][0].max() < 64
    np.testing.assert_array_equal(looks["light"][1], looks["dark"][1])


def test_no_text_of_the_page_is_markup(page):
    page.get_by_role("button", name="Set: write scene and pictures").click()
    page.get_by_text(HOSTILE, exact=True).wait_for()
    assert page.locator("iframe").count() == 0


def test_no_request_leaves_the_machine(session, page):
    home = f"//127.0.0.1:{session.gate.port}"
    asked = [url for url in page.requests if url.startswith(("http", "ws"))]
    assert len(asked) >= 2  # the page and its websocket
    assert all(home in url for url in asked), asked
