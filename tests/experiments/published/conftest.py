from types import SimpleNamespace

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.published import layout
from experiments.published.layout import PLACEMENTS, captures, place_of
from experiments.published.setting import PublishedSetting
from experiments.setting import FittedScene
from tests.scenes.published import LIT, PAINT, SBRS, save_capture

HIDDEN, PHOTOGRAPH = (10, 12), (42, 42)


class RenderedSet:
    """Captures of the layout, of the first placement of each folder."""

    def __init__(self, root, hidden=HIDDEN, photograph=PHOTOGRAPH):
        self.root, self.hidden, self.photograph = root, hidden, photograph
        self.scenes = {}
        self.paint = 1 + PAINT * np.random.default_rng(5).normal(size=(*photograph, 1))

    def scene(self, place):
        """The scene with the very A of the page: what it cannot explain is noise and paint."""
        if place not in self.scenes:
            first = PLACEMENTS[place][0]
            self.scenes[place] = FittedScene(
                first.scene, self.hidden, PublishedSetting.seed, first.parameters, self.photograph
            )
        return self.scenes[place]

    def truth(self, name):
        pictures = {"bur": "letters", "colbar": "bars", "smilehat": "still_life", "tommy": "digits"}
        shown = next((image for part, image in pictures.items() if part in name), "mushroom")
        return ps.read_hidden_image(ps.find_image(shown), self.hidden)

    def lit_block(self, name):
        down, right = (count / size for count, size in zip(self.hidden, HIDDEN, strict=True))
        row, column = LIT[name.rpartition("image_test_")[2]]
        truth = np.zeros((*self.hidden, 3))
        truth[int(row * down), int(column * right)] = 1
        return truth

    def light(self, place, truth):
        scene = self.scene(place)
        f = truth.reshape(-1, 3)
        full = (scene.A @ np.ones((f.shape[0], 3))).mean()
        return (scene.A @ f).reshape(*self.photograph, 3) / full

    def ambient(self, place):
        """Light of two lamps on no point of the paper's grid, of mean 1."""
        lamps = np.array([[-1.3, 2.2, 0.9], [0.8, 1.4, 2.1]])
        lit = ps.point_light_backgrounds(self.scene(place).scenario, lamps)
        colours = np.array([[1.0, 0.9, 0.7], [0.8, 0.9, 1.0]])
        light = (lit / lit.mean(axis=0) @ colours).reshape(*self.photograph, 3)
        return light / light.mean()

    def write(self, names, **how):
        for number, name in enumerate(names):
            folder, _, last = name.rpartition("/")
            place = place_of(folder)
            truth = self.truth(f"{folder}/{last}")
            if folder == layout.SINGLE_PIXELS:
                truth = self.lit_block(last)
            elif folder in layout.FRAMES:
                truth = np.roll(truth, number % 13, axis=1)
            light = self.light(place, truth)
            level = int(last[-1]) if last[-1].isdigit() and ("amb" in last or "mush" in last) else 0
            if level:
                alone = self.ambient(place) * light.mean() / SBRS[level - 1]
                is_alone = "mush" not in last
                light, truth = (alone, None) if is_alone else (light + alone, truth)
            given = {"exposure": 20.0 + 5 * (number % 3), "seed": number, **how}
            save_capture(self.root / f"{name}.mat", light * self.paint, truth, **given)


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """All captures but repeats beyond the fourth and frames beyond the third; some damaged."""
    root = tmp_path_factory.mktemp("published") / "Data"
    rendered = RenderedSet(root)
    many = (layout.REPEATS, layout.FRAMES)
    left_out = {f"{folder}/{name}" for part in many for folder in part for name in part[folder][4:]}
    rendered.write([name for name in captures() if name not in left_out])
    short = root / layout.PLATE / "image_test_bur.mat"
    short.write_bytes(short.read_bytes()[:5000])
    (root / "stranger.mat").write_bytes(b"")
    return SimpleNamespace(root=root, rendered=rendered, left_out=left_out)


@pytest.fixture(scope="session")
def fitted_scenes(data):
    """Scenes already rendered and fitted, by what they are of: no test changes one."""
    return {
        (scene.scene, *sorted(scene.parameters.items())): scene
        for scene in data.rendered.scenes.values()
    }


@pytest.fixture
def every_placement(data, tmp_path, monkeypatch, fitted_scenes):
    fit = PublishedSetting.scene

    def scene(setting, placement, parameters=None):
        key = placement.scene, *sorted({**placement.parameters, **(parameters or {})}.items())
        if key not in fitted_scenes:
            fitted_scenes[key] = fit(setting, placement, parameters)
        return fitted_scenes[key]

    monkeypatch.setattr(PublishedSetting, "scene", scene)
    return PublishedSetting(
        tmp_path / "out", data.root.parent, hidden=HIDDEN, photograph=PHOTOGRAPH
    )


@pytest.fixture
def setting(every_placement):
    """Knows the placement that was rendered, which need not be found."""
    for folder, placements in PLACEMENTS.items():
        every_placement.placements[folder] = placements[:1]
    return every_placement
