from collections import Counter

import numpy as np
import pytest

from periscopy_sim.dataset.samples import draw_clip, draw_geometry


def test_draws_depend_on_seed_and_number_alone(configured):
    configuration = configured()
    larger = configured(count=10_000)
    for number in (0, 5, 4000):
        one, two = draw_clip(configuration, number), draw_clip(larger, number)
        np.testing.assert_array_equal(one.hidden["hidden"], two.hidden["hidden"])
        assert (one.sbr, one.snr, one.exposure) == (two.sbr, two.snr, two.exposure)
        assert draw_geometry(configuration, number) == draw_geometry(larger, number)
    other = configured(seed=4)
    assert draw_clip(other, 0).snr != draw_clip(configuration, 0).snr
    assert draw_geometry(other, 0).parameters != draw_geometry(configuration, 0).parameters


def test_sources_are_drawn_by_weight(configured):
    configuration = configured(
        hidden_images=[{"kind": "digits", "weight": 3}, {"kind": "smooth", "weight": 1}],
        ambient=[{"kind": "none", "weight": 1}, {"kind": "lamps", "weight": 9}],
        clip_length=1,
    )
    clips = [draw_clip(configuration, number) for number in range(600)]
    kinds = Counter(clip.kind for clip in clips)
    dark = sum(clip.ambient.label == "none" for clip in clips)
    # Binomial, 4.5 standard deviations each: wrong for a right draw once in 10⁵ seeds.
    assert abs(kinds["digits"] - 450) < 4.5 * np.sqrt(600 * 0.75 * 0.25)
    assert abs(dark - 60) < 4.5 * np.sqrt(600 * 0.1 * 0.9)
    assert all((clip.sbr == np.inf) == (clip.ambient.label == "none") for clip in clips)


def test_geometries_are_shared_among_the_splits_by_their_shares(configured):
    for seed, count in ((0, 11), (1, 100)):
        configuration = configured(seed=seed)
        splits = Counter(draw_geometry(configuration, n).split for n in range(count))
        for split, share in {"train": 0.8, "validation": 0.1, "test": 0.1}.items():
            assert abs(splits[split] - share * count) <= 2


def test_scene_that_comes_again_is_in_one_split_and_the_first_geometry_in_the_largest(configured):
    scenes = [
        {"scene": "chair", "parameters": {"resolution": {"choice": [16, 18, 20]}}},
        {"scene": "plate"},
        {"scene": "chair", "parameters": {"occluder_dx": {"uniform": [0, 0.1]}}, "weight": 3},
    ]
    for seed in range(10):
        configuration = configured(seed=seed, scenes=scenes)
        splits = {}
        for number in range(120):
            drawn = draw_geometry(configuration, number)
            pose = (drawn.source, tuple(drawn.parameters.items()))
            assert splits.setdefault(pose, drawn.split) == drawn.split
        assert len(splits) > 40
        assert draw_geometry(configured(seed=seed), 0).split == "train"


def test_splits_do_not_depend_on_where_a_scene_lies(configured, tmp_path):
    splits = set()
    for number in range(12):
        folder = tmp_path / str(number)
        folder.mkdir()
        scene = folder / "scene.xml"
        scene.write_text("<scene/>")
        configuration = configured(
            scenes=[{"scene": str(scene)}], splits={"train": 0.4, "validation": 0.3, "test": 0.3}
        )
        splits.add(draw_geometry(configuration, 0).split)
    assert len(splits) == 1


def test_conditions_are_mixed_without_repeats_and_turned(configured):
    names = ["overcast", "low_sun", "corridor"]
    entry = {"kind": "conditions", "names": names, "mixed": {"choice": [1, 2, 5]}}
    configuration = configured(ambient=[entry])
    draws = [draw_clip(configuration, number).ambient for number in range(300)]
    lengths = Counter(len(ambient.mixture) for ambient in draws)
    assert set(lengths) == {1, 2, 3}
    for ambient in draws:
        chosen = [which for which, *_ in ambient.mixture]
        assert len(set(chosen)) == len(chosen)
        assert ambient.label == " + ".join(names[which] for which in chosen)
        assert sum(weight for _, weight, _, _ in ambient.mixture) == pytest.approx(1)
    turned = Counter((down, across) for a in draws for _, _, down, across in a.mixture)
    assert len(turned) == 4 and min(turned.values()) > 80
    upright = configured(ambient=[{**entry, "flip": False}])
    assert not any(
        down or across
        for n in range(50)
        for _, _, down, across in draw_clip(upright, n).ambient.mixture
    )


def test_lamps_lie_where_they_are_asked_for(configured):
    entry = {"kind": "lamps", "number": 3, "across": 0.5, "away": {"uniform": [2, 3]}, "up": -1}
    for number in range(20):
        places, powers = draw_clip(configured(ambient=[entry]), number).ambient.lamps
        assert places.shape == powers.shape == (3, 3)
        assert (places[:, 0] == 0.5).all() and (places[:, 2] == -1).all()
        assert (places[:, 1] >= 2).all() and (places[:, 1] <= 3).all()
        assert (powers > 0).all()
