"""A stream on the page: what a person sees, presses and moves while frames come."""

import time
from functools import partial
from threading import Event

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.benchmarks import live
from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.live import frames as preparation
from periscopy_sim.live import watch as live_watch
from periscopy_sim.live.frames import TAKEN, Companions, open_source
from periscopy_sim.live.watch import WatchSession
from periscopy_sim.photographs import prepare
from periscopy_sim.photographs.wall_view import WallTags
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.scenario import load_scenario

pytest.importorskip("websockets")
PATIENCE = 240.0
NOISE = 0.004


class Camera:
    """A camera of 16 bits whose pixels, `side` by `side`, see what one of the film's sees."""

    def __init__(self, scenario, image):
        A = ps.transport(scenario)
        light = (A @ image.reshape(-1, 3)).reshape(*scenario.photograph_shape, 3)
        self.shape = scenario.photograph_shape
        self.ambient = np.linspace(0.2, 0.3, 24)[:, None, None] * np.ones((24, 24, 3))
        self.signal = 0.2 * light / light.mean() * scenario.channel_gain
        self.is_on, self.side, self.more_rows, self.glare = True, 2, 0, 0.0
        self.random = np.random.default_rng(1)

    def __call__(self):
        time.sleep(0.01)
        light = self.ambient + self.signal * self.is_on
        light[:2, :2] += self.glare
        light = light.repeat(self.side, axis=0).repeat(self.side, axis=1)
        light = np.concatenate([light, light[: self.more_rows]])
        noise = self.random.normal(0, NOISE * self.side, light.shape)
        return np.clip(2**16 * (light + noise), 0, 65535).astype(np.uint16)


class Watched:
    """A session of a camera, and what it has shown and said."""

    def __init__(self):
        self.scenario = load_scenario("plate", (6, 8), {"resolution": 24})
        self.image = ps.read_hidden_image(ps.find_image("mushroom"), (6, 8))
        self.camera = Camera(self.scenario, self.image)
        self.shown, self.said, self.saved = [], [], []
        self.session = WatchSession(
            open_source(self.camera, linear=True), self.scenario, "noise-aware", self.save,
            self.describe, count=20, say=self.said.append,
            record=lambda *each: self.shown.append(each),
        )  # fmt: skip

    def describe(self, report):
        return [report.verdict.code]

    def save(self, pictures):
        self.saved.append(pictures)
        return "saved"

    def press(self, name, value=True):
        self.session._receive({"control": name, "value": value})

    def until(self, holds):
        """Wait for pictures of full size that come from now on, or for something else."""
        end, start = time.monotonic() + PATIENCE, len(self.shown)
        while True:
            for pictures, progress in self.shown[start:]:
                if not pictures.is_coarse and holds(pictures, progress):
                    return pictures, progress
            assert time.monotonic() < end, self.said
            time.sleep(0.02)


@pytest.fixture(scope="module")
def watched():
    made = Watched()
    with made.session, live.running(made.session):
        made.until(lambda *_: True)
        yield made


def test_frames_are_averaged_until_the_picture_is_sharp(watched):
    pictures, progress = watched.until(lambda _, progress: progress.averaged > 19)
    assert ps.psnr_gain_matched(pictures.image, watched.image) > 25
    level = np.mean(watched.camera.ambient + watched.camera.signal)
    assert progress.noise == pytest.approx(NOISE / level, rel=0.3)
    assert progress.noise_left == pytest.approx(NOISE / level / np.sqrt(20), rel=0.3)
    residual = pictures.report.residual
    assert residual.unexplained < 2 * residual.noise_alone
    status = watched.session.gate._state["status"][1]
    assert "frames a second, latency" in status and "average of" in status


def test_a_scene_that_moves_is_reconstructed_anew_while_frames_come(watched):
    before = watched.until(lambda *_: True)[0]
    watched.press("value occluder_dx", 0.02)
    moved = watched.until(lambda each, _: each.choice.values["occluder_dx"] == 0.02)[0]
    psnrs = [ps.psnr_gain_matched(each.image, watched.image) for each in (before, moved)]
    assert psnrs[1] < psnrs[0] - 5
    assert any(each.is_coarse for each, _ in watched.shown)
    watched.press("undo")
    back = watched.until(lambda each, _: each.choice.values["occluder_dx"] == 0)[0]
    assert ps.psnr_gain_matched(back.image, watched.image) > psnrs[0] - 4
    rejected = watched.session.choice
    watched.press("undo")  # nothing is left to undo
    assert watched.session.choice == rejected


def test_pictures_of_the_average_are_set_down_with_standard_errors(watched):
    watched.press("save")
    watched.until(lambda *_: watched.saved)
    pictures = watched.saved[-1]
    assert pictures.report.standard_errors.shape == (6, 8, 3) and pictures.frame is None
    truth = watched.camera.ambient + watched.camera.signal
    error = (pictures.photograph.values / 2**16 - truth).std()
    assert error < NOISE / 3


def test_frames_of_another_size_are_prepared_anew_or_named(watched):
    camera = watched.camera
    camera.side = 3
    watched.until(lambda *_: any("from 48 x 48 to 72 x 72" in line for line in watched.said))
    watched.until(lambda _, progress: 5 < progress.averaged < 15)
    camera.more_rows = 1
    end = time.monotonic() + PATIENCE
    while not any("73 x 72 pixels (rows x columns) do not" in line for line in watched.said):
        assert time.monotonic() < end
        time.sleep(0.02)
    camera.side, camera.more_rows = 2, 0
    watched.until(lambda _, progress: progress.averaged > 5)


def test_the_average_becomes_the_photograph_with_the_monitor_off(watched):
    watched.camera.is_on = False
    watched.press("average", 5.0)
    assert watched.session.count == 5
    count = len(watched.shown)
    watched.until(lambda *_: len(watched.shown) > count + 40)
    watched.press("monitor off")
    off = watched.session.photograph().monitor_off
    np.testing.assert_allclose(off[TAKEN] / 2**16, watched.camera.ambient, atol=0.01)
    watched.camera.is_on = True
    watched.until(lambda each, _: ps.psnr_gain_matched(each.image, watched.image) > 25)


class Brief:
    """A stream of a function's frames, and what it has shown and said."""

    def __init__(self, function, companions=None, method="noise-aware"):
        scenario = load_scenario("plate", (6, 8), {"resolution": 24})
        self.shown, self.said = [], []
        self.session = WatchSession(
            open_source(function, linear=True), scenario, method, lambda _: "", lambda _: [],
            companions=companions, count=20, say=self.said.append,
            record=lambda *each: self.shown.append(each),
        )  # fmt: skip

    def press(self, name, value=True):
        self.session._receive({"control": name, "value": value})

    def until(self, holds):
        end = time.monotonic() + PATIENCE / 4
        while not holds():
            assert time.monotonic() < end, self.said
            time.sleep(0.02)


TAGS = WallTags(np.arange(2), np.zeros((2, 3)), np.ones(2))
WALL = np.linspace(9000, 20000, 24 * 24 * 3).reshape(24, 24, 3).astype(np.uint16)


def test_a_single_frame_is_shown_in_full_and_again_after_each_change(monkeypatch):
    ended = Event()

    def frames():
        yield WALL
        ended.wait()
        yield None

    brief = Brief(frames().__next__)
    with brief.session, live.running(brief.session):
        brief.until(lambda: brief.shown and not brief.shown[-1][0].is_coarse)
        status = brief.session.gate._state
        brief.until(lambda: "one frame, whose noise" in status["status"][1])
        assert "waiting" not in status["status"][1]
        brief.session.report("the folder is gone")
        assert "latency" in status["status"][1] and "the folder is gone" in status["status"][1]
        monkeypatch.setattr(brief.session, "_expires", 0.0)  # as some seconds later
        brief.press("value occluder_dx", 0.02)
        brief.until(
            lambda: any(
                not each.is_coarse and each.choice.values["occluder_dx"] == 0.02
                for each, _ in brief.shown
            )
        )
        brief.until(lambda: "gone" not in status["status"][1])
        ended.set()
    assert {progress.frame for _, progress in brief.shown} == {0}
    assert brief.session.shown == 1 and brief.session.dropped == 0


def test_the_frames_are_prepared_at_a_later_try(monkeypatch):
    tries = []

    def film_pixels(*each):
        tries.append(each)
        if len(tries) == 1:
            raise PhotographError("no tag is visible")
        return prepare.FilmPixels(*each)

    monkeypatch.setattr(preparation, "FilmPixels", film_pixels)
    brief = Brief(lambda: time.sleep(0.01) or WALL)
    with brief.session, live.running(brief.session):
        brief.until(lambda: brief.shown)
    assert len(tries) == 2 and any("no tag" in line for line in brief.said)


@pytest.mark.parametrize(
    ("frame", "has_tags"), [(WALL, True), (WALL[:-1], False), (0 * WALL, False)]
)
def test_frames_of_a_wrong_size_or_black_end_the_session_unless_tags_may_appear(frame, has_tags):
    companions = Companions(marks=TAGS) if has_tags else None
    brief = Brief(lambda: time.sleep(0.01) or frame, companions)
    with brief.session, live.running(brief.session):
        assert brief.session.ended.wait(1.0 if has_tags else PATIENCE / 4) is not has_tags
    assert isinstance(brief.session.fault, PhotographError) is not has_tags
    assert not brief.shown


def test_a_right_and_a_wrong_scene_are_judged_by_the_average(monkeypatch):
    monkeypatch.setattr(live_watch, "JUDGED", 0.1)
    watched = Watched()

    def is_judged(code):
        return code in watched.session.gate._state.get("status", [0, []])[1]

    with watched.session, live.running(watched.session):
        for shift, code in (0.0, "fits"), (0.03, "does_not_fit"):
            watched.press("value occluder_dx", shift)
            watched.until(lambda *_, code=code: is_judged(code))


def test_a_camera_of_black_frames_is_doubted_once_while_they_come(monkeypatch):
    monkeypatch.setattr(live_watch, "JUDGED", 0.1)
    rng = np.random.default_rng(0)
    brief = Brief(lambda: time.sleep(0.01) or rng.poisson(0.5, WALL.shape).astype(np.uint16))
    monkeypatch.setattr(brief.session, "_describe", Report.lines)
    with brief.session, live.running(brief.session):
        brief.until(lambda: sum("no hidden image" in line for line in brief.said))
        verdict = brief.session.verdict
        brief.until(lambda: brief.session.verdict not in (verdict, None))
    assert sum("no hidden image" in line for line in brief.said) == 1


def test_what_no_frame_could_be_shown_for_stays_on_the_page(monkeypatch):
    monkeypatch.setattr(live_watch, "JUDGED", 0.05)
    monkeypatch.setattr(live_watch, "NEWS", 0.1)
    ended = Event()

    def frames():
        yield WALL
        ended.wait()
        yield None

    brief = Brief(frames().__next__, Companions(marks=TAGS))
    with brief.session, live.running(brief.session):
        brief.until(lambda: any("tag" in line for line in brief.said))
        time.sleep(1.0)
        assert "tag" in brief.session.gate._state["trouble"][1]
        ended.set()
    assert not brief.shown


@pytest.mark.parametrize("is_early", [False, True])
def test_a_camera_that_ends_without_a_method_ends_the_session(is_early):
    mask = np.zeros((24, 24), bool)
    mask[0, :3] = True

    def frames():
        yield WALL
        if not is_early:  # the method is known to fail
            brief.until(lambda: any("pixels" in line for line in brief.said[1:]))
        yield None

    brief = Brief(frames().__next__, Companions(mask=mask))
    with brief.session, live.running(brief.session):
        assert brief.session.ended.wait(PATIENCE / 4)
    assert not brief.shown and isinstance(brief.session.fault, PeriscopyError)


def test_what_cannot_be_watched_is_refused_at_once():
    scenario = load_scenario("plate", (6, 8), {"resolution": 24})
    for wrong in {"method": "nonsense"}, {"average": 0}:
        with pytest.raises(PeriscopyError, match=next(iter(wrong))):
            ps.watch(lambda: None, scenario, port=0, **wrong)


@pytest.mark.parametrize("ends_by", [None, "error"])
def test_the_last_average_is_shown_in_full_size_and_an_error_is_raised(ends_by, capsys):
    frames, shown = iter([WALL] * 3), []

    def camera():
        if ends_by == "error":
            time.sleep(0.1 * (not shown))
            return next(frames, WALL) if not shown else [][0]
        return next(frames, None)

    def record(pictures, progress):
        shown.append((pictures, progress))

    scenario = load_scenario("plate", (6, 8), {"resolution": 24})
    watch = partial(ps.watch, camera, scenario, linear=True, record=record, port=0)
    if ends_by == "error":
        with pytest.raises(PeriscopyError, match=r"camera' failed: IndexError.*test_watch.py"):
            watch()
    else:
        watch()
        assert not shown[-1][0].is_coarse and shown[-1][1].frame < 3
    assert "http://127.0.0.1" in capsys.readouterr().out


def test_a_defect_of_the_stream_is_raised(monkeypatch):
    monkeypatch.setattr(preparation.RunningAverage, "add", lambda *_: {}["defect"])
    with pytest.raises(KeyError, match="defect"):
        ps.watch(
            lambda: time.sleep(0.01) or WALL,
            load_scenario("plate", (6, 8), {"resolution": 24}),
            linear=True,
            port=0,
        )


def test_frames_of_other_channels_are_left_out_whatever_their_size():
    frames = iter([WALL, WALL[..., :1], WALL[::2, ::2, :1], None])
    brief = Brief(lambda: time.sleep(0.2) or next(frames))
    with brief.session, live.running(brief.session):
        assert brief.session.ended.wait(PATIENCE / 4)
    assert brief.session.fault is None and brief.shown[-1][0].photograph.channels == 3
    assert sum("1 channels" in line for line in brief.said) == 1


def test_the_monitor_off_frame_is_taken_between_two_frames(monkeypatch):
    """Pressed at any moment: the average is that of whole frames, and no press is lost."""
    begun, add = Event(), preparation.RunningAverage.add

    def slow_add(frames, frame, count=1):
        begun.set()
        average, frames.average = frames.average, None
        time.sleep(0.2)
        frames.average = average
        return add(frames, frame, count)

    brief = Brief(lambda: time.sleep(0.01) or WALL)
    with brief.session, live.running(brief.session):
        brief.until(lambda: brief.shown)
        monkeypatch.setattr(preparation.RunningAverage, "add", slow_add)
        begun.clear()
        assert begun.wait(PATIENCE / 4)
        brief.press("monitor off")
        assert brief.session.has_monitor_off
        np.testing.assert_allclose(brief.session.photograph().monitor_off[TAKEN], WALL)
