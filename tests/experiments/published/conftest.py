from types import SimpleNamespace

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.published.setting import (
    BLOCKS,
    REPEATS,
    VIDEOS,
    PublishedSetting,
    sets_of_captures,
)
from experiments.setting import FittedScene
from tests.scenes.published import LIT, PAINT, SBRS, save_capture

HIDDEN, PHOTOGRAPH = (10, 12), (42, 42)


class RenderedSet:
    """Captures of the published sets, each of its set's scene."""

    def __init__(self, root):
        self.root = root
        self.scenes = {}
        self.paint = 1 + PAINT * np.random.default_rng(5).normal(size=(*PHOTOGRAPH, 1))

    def scene(self, of):
        """The scene with the very A of the page: what it cannot explain is noise and paint."""
        key = of.scene, *sorted(of.parameters.items())
        if key not in self.scenes:
            given = HIDDEN, PublishedSetting.seed, of.parameters, PHOTOGRAPH
            self.scenes[key] = FittedScene(of.scene, *given)
        return self.scenes[key]

    def truth(self, name):
        pictures = {"bur": "letters", "colbar": "bars", "smilehat": "still_life", "tommy": "digits"}
        shown = next((image for part, image in pictures.items() if part in name), "mushroom")
        return ps.read_hidden_image(ps.find_image(shown), HIDDEN)

    def lit_block(self, name):
        truth = np.zeros((*HIDDEN, 3))
        truth[LIT[name.rpartition("image_test_")[2]]] = 1
        return truth

    def light(self, scene, truth):
        f = truth.reshape(-1, 3)
        full = (scene.A @ np.ones((f.shape[0], 3))).mean()
        return (scene.A @ f).reshape(*PHOTOGRAPH, 3) / full

    def ambient(self, scene):
        """Light of two lamps on no point of the paper's grid, of mean 1."""
        lamps = np.array([[-1.3, 2.2, 0.9], [0.8, 1.4, 2.1]])
        lit = ps.point_light_backgrounds(scene.scenario, lamps)
        colours = np.array([[1.0, 0.9, 0.7], [0.8, 0.9, 1.0]])
        light = (lit / lit.mean(axis=0) @ colours).reshape(*PHOTOGRAPH, 3)
        return light / light.mean()

    def write(self, name, of, files):
        scene = self.scene(of)
        for number, file in enumerate(files):
            last = file.rpartition("/")[2].removesuffix(".mat")
            truth = self.lit_block(last) if name == BLOCKS else self.truth(file)
            if name in VIDEOS:
                truth = np.roll(truth, number, axis=1)
            light = self.light(scene, truth)
            level = int(last[-1]) if last[-1].isdigit() and ("amb" in last or "mush" in last) else 0
            if level:
                alone = self.ambient(scene) * light.mean() / SBRS[level - 1]
                is_alone = "mush" not in last
                light, truth = (alone, None) if is_alone else (light + alone, truth)
            given = {"exposure": 20.0 + 5 * (number % 3), "seed": number}
            save_capture(self.root / file, light * self.paint, truth, **given)


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """All captures but repeats beyond the fourth and frames beyond the third; one is damaged."""
    root = tmp_path_factory.mktemp("published") / "Data"
    rendered = RenderedSet(root)
    for name, of in sets_of_captures().items():
        files = list(of.files)
        if name in VIDEOS:
            files = files[:3]
        elif name == REPEATS:
            files = [file for file in files if file[-6:-4] in ("t0", "t1", "t2", "t3")]
        rendered.write(name, of, files)
    short = root / "TestPosD11/image_test_bur.mat"
    short.write_bytes(short.read_bytes()[:5000])
    return SimpleNamespace(root=root, rendered=rendered)


@pytest.fixture
def setting(data, tmp_path, monkeypatch):
    """Scenes already rendered and fitted: no test changes one."""
    monkeypatch.setattr(
        PublishedSetting, "scene", lambda self, name: data.rendered.scene(self.sets[name])
    )
    return PublishedSetting(
        tmp_path / "out", data.root.parent, hidden=HIDDEN, photograph=PHOTOGRAPH
    )
