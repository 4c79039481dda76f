from contextlib import nullcontext

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import PhotographError
from periscopy_sim.live import frames as preparation
from periscopy_sim.live.frames import TAKEN, CameraFrame, Companions, RunningAverage, light_of_codes
from periscopy_sim.photographs.develop import SensorImage, sensor_image
from periscopy_sim.scenario import load_scenario
from periscopy_sim.storage.rasters import srgb_light

RNG = np.random.default_rng(4)
CODES = RNG.normal(120, 3, (96, 96, 3)).clip(0, 254).astype(np.uint8)
WALL = np.linspace(0.2, 0.4, 24 * 24 * 3).reshape(24, 24, 3)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("plate", (6, 8), photograph=(24, 24))


def light(values, full=None):
    return CameraFrame(sensor_image(values, "frame", saturated=full).infinite)


def coded(codes, *, linear=False):
    return CameraFrame(codes, light_of_codes(codes.dtype, linear=linear))


def averaged(scenario, values, count=1):
    frames = RunningAverage(light(WALL), scenario, Companions())
    return frames, [frames.add(light(each), count) for each in values]


def test_codes_are_prepared_as_prepare_does_it_with_a_photograph(scenario):
    mask = np.ones((96, 96), bool)
    mask[:8, 40:] = False
    dark = sensor_image(np.full(CODES.shape, 0.02, np.float32), "dark")
    codes = CODES.copy()
    codes[50, 50] = 255
    companions = Companions(mask=mask, dark=dark, monitor_off={"off": dark})
    first = RunningAverage(coded(CODES), scenario, companions)
    prepared = first.prepare(coded(codes))
    full = (codes == 255).any(axis=2)
    expected = ps.prepare(
        ps.develop([SensorImage(srgb_light(codes).astype(np.float32), full)], dark=dark),
        scenario, mask=mask,
    )  # fmt: skip
    full, used = np.isinf(prepared).any(axis=2), expected.mask
    np.testing.assert_array_equal(first._pixels.mask & ~full, used)
    np.testing.assert_array_equal(np.argwhere(full), [[12, 12]])
    np.testing.assert_allclose(prepared[used], expected.values[used], atol=1e-6)
    np.testing.assert_allclose(first._monitor_off["off"], 0, atol=1e-7)
    linear = RunningAverage(coded(CODES, linear=True), scenario, Companions(black=16))
    blocks = CODES.reshape(24, 4, 24, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(linear.prepare(coded(CODES, linear=True)), blocks - 16, rtol=1e-5)
    with pytest.raises(PhotographError, match="the dark frame: 3 channels"):
        RunningAverage(coded(CODES[..., :1]), scenario, companions)
    with pytest.raises(PhotographError, match="100 x 96"):
        RunningAverage(coded(np.ones((100, 96, 3), np.uint8)), scenario, Companions())


def test_the_average_leaves_the_noise_that_it_says(scenario):
    noisy = WALL + RNG.normal(0, 0.003, (200, *WALL.shape))
    frames, lines = averaged(scenario, noisy, count=25)
    assert not any(lines)
    averages, noise, noise_left = frames.numbers
    assert averages == pytest.approx(25, rel=0.01)
    assert noise == pytest.approx(0.003 / WALL.mean(), rel=0.1)
    left = (frames.average - WALL).std() / WALL.mean()
    assert noise_left == pytest.approx(left, rel=0.15)
    assert left == pytest.approx(noise / 5, rel=0.15)


def test_another_exposure_is_noticed_and_another_picture_is_not(scenario):
    moved = WALL.copy()
    moved[:, :12] *= 1.3  # light from one side
    frames, lines = averaged(scenario, [WALL, moved, moved * 1.25], count=9)
    assert not lines[0] and "differ" in lines[1][0] and "times what it was" in lines[2][0]
    assert frames.numbers[0] == 1
    np.testing.assert_allclose(frames.average, moved * 1.25, rtol=1e-6)


def test_clicks_of_the_exposure_start_the_average_and_its_mask_anew(scenario):
    levels = [2.0] * 5 + [1.6] * 3 + [0.9] * 9
    full = np.zeros((24, 24), bool)
    full[:12] = True
    frames = RunningAverage(light(WALL), scenario, Companions())
    for level in levels:
        frames.add(light(WALL * level, full if level > 1 else None), 100)
    np.testing.assert_allclose(frames.average, WALL * 0.9, rtol=1e-6)
    assert frames.numbers[0] == pytest.approx(9) and frames._mask.all()


def test_saturated_pixels_leave_the_mask_now_and_then(scenario, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(preparation.time, "monotonic", lambda: clock[0])
    frames = RunningAverage(light(WALL), scenario, Companions())
    walls = []
    for k in range(4):
        full = np.zeros((24, 24), bool)
        full[k, 3] = True
        assert "saturated: " in frames.add(light(WALL, full))[0]
        walls.append(frames.wall)
    assert walls[0] is walls[3] and (~walls[0].pixels).sum() == 1
    clock[0] += preparation.STEADY
    frames.add(light(WALL))
    assert (~frames.wall.pixels).sum() == 4


def test_a_method_formed_before_pixels_saturate_sees_their_average(
    scenario, level, choice, monkeypatch
):
    monkeypatch.setattr(preparation, "STEADY", 0)
    frames = RunningAverage(light(WALL), scenario, Companions())
    frames.add(light(WALL))
    formed = level(photograph=frames.photograph()).fit(choice)
    before = formed.see(frames.photograph(), 0.01, 0).image
    full = np.zeros((24, 24), bool)
    full[5:8] = True
    frames.add(light(np.where(full[..., None], 9, WALL), full))
    assert (~frames.wall.pixels).sum() == 72
    after = formed.see(frames.photograph(), 0.01, 1).image
    np.testing.assert_allclose(after, before, atol=0.01 * np.abs(before).max())


@pytest.mark.parametrize("white_at", [0, 2])
def test_a_white_frame_is_left_out(scenario, white_at):
    frames = RunningAverage(light(WALL), scenario, Companions())
    for k in range(5):
        white = np.full((24, 24), k == white_at)
        frame = light(np.where(white[..., None], 1.0, WALL), white)
        if k == white_at:
            with pytest.raises(PhotographError, match="saturated"):
                frames.add(frame, 9)
            assert frames.wall is None  # so that methods are formed anew
        else:
            frames.add(frame, 9)
    np.testing.assert_allclose(frames.photograph().values, WALL, rtol=1e-6)
    assert frames.photograph().pixels.all() and frames.numbers[0] == pytest.approx(4 - white_at)


def test_the_average_becomes_the_monitor_off_frame(scenario):
    frames, _ = averaged(scenario, [WALL / 2])
    before = frames.wall
    frames.toggle_monitor_off()
    assert frames.wall is not before and before.conditions != frames.wall.conditions
    np.testing.assert_allclose(frames.wall.monitor_off[TAKEN], WALL / 2)
    frames.toggle_monitor_off()
    assert frames.wall.conditions == before.conditions


@pytest.mark.parametrize(("change", "noise", "is_told"), [(0.3, 0.05, True), (0.0, 0.3, False)])
def test_frames_that_differ_by_more_than_noise_are_told_from_noise(
    change, noise, is_told, scenario
):
    """Seeds 0 to 9; noise alone has a fourth of the threshold in 600 draws."""
    for seed in range(10):
        rng, other = np.random.default_rng(seed), WALL.copy()
        other[6:12, 6:18] *= 1 + change
        values = [each * rng.normal(1, noise, WALL.shape) for each in (WALL, other)]
        _, (_, lines) = averaged(scenario, values, 9)
        assert any("differ" in line for line in lines) is is_told
        exposures = [SensorImage(v.astype(np.float32), np.zeros((24, 24), bool)) for v in values]
        with pytest.warns(RuntimeWarning) if is_told else nullcontext():
            ps.develop(exposures)
