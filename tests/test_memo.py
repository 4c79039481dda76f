import copy
import errno
import os
import pickle
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim import memo as memos
from periscopy_sim.errors import OutputError
from periscopy_sim.memo import Memo
from periscopy_sim.rendering import ambient

pytestmark = pytest.mark.usefixtures("quick_light")


class Maker:
    """Make an object anew at each call, and count these."""

    calls = 0

    def __call__(self):
        self.calls += 1
        return object()


def test_a_key_has_one_object():
    memo, make = Memo(), Maker()
    assert memo.get("a", make) is memo.get("a", make) is not memo.get("b", make)
    assert make.calls == 2


def test_the_least_recently_used_make_room():
    memo, make = Memo(10), Maker()
    kept = {key: memo.get(key, make, size) for key, size in (("a", 4), ("b", 4), ("light", 0))}
    assert memo.get("a", make, 4) is kept["a"]
    memo.get("c", make, 4)
    assert memo.get("a", make, 4) is kept["a"] and memo.get("light", make) is kept["light"]
    assert memo.get("b", make, 4) is not kept["b"]
    large = memo.get("large", make, 1000)
    assert memo.get("large", make, 1000) is large and memo.get("light", make) is kept["light"]
    assert memo.get("a", make, 4) is not kept["a"]


def test_what_a_failing_make_leaves_is_made_again():
    def fail():
        raise ValueError("lost")

    memo = Memo()
    for _ in range(2):
        with pytest.raises(ValueError, match="lost"):
            memo.get("a", fail)
    assert memo.get("a", lambda: 1) == 1


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda memo: pickle.loads(pickle.dumps(memo))]
)
def test_a_copy_begins_empty(copied):
    memo, make = Memo(7), Maker()
    first = memo.get("a", make)
    other = copied(memo)
    assert other.most_bytes == 7 and other.get("a", make) is not first
    assert memo.get("a", make) is first


def test_threads_make_things_in_turn_and_each_once():
    memo, running, made, together = Memo(), [], [], []

    def make():
        running.append(threading.get_ident())
        time.sleep(0.02)
        together.append(len(running))
        running.pop()
        return object()

    threads = [
        threading.Thread(target=lambda key=key: made.append((key, memo.get(key, make))))
        for key in "aabb" * 2
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == [1, 1] and len({*made}) == 2


KINDS = {
    "A": lambda scene: scene.A,
    "plan": lambda scene: scene.plan().error,
    "bounces": lambda scene: replace(scene, light=ps.Light(by="rays", samples=4, bounces=2)).A.mean,
    "photograph": lambda scene: scene.photograph(np.ones((4, 5, 3)), bounces=1).values,
    "ambient": lambda scene: scene.ambient(OVERCAST, target=0.2).photograph,
}
MAKERS = {
    "rendering.transport": ("planned", "render_transport", "area_transport"),
    "rendering.bounced": ("render_bounced_light",),
    "rendering.photograph": ("rendering_of",),
    "rendering.ambient": ("render_background",),
}
OVERCAST = ps.find_scene("ambient/overcast")


def chair(folder=None, **parameters):
    scene = ps.load_scenario("chair", (4, 5), {"resolution": "12", **parameters})
    return replace(scene, memo=Memo(folder=folder))


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder in which a scenario kept one of each kind, and what it made."""
    folder = tmp_path_factory.mktemp("kept")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PERISCOPY_DATA", str(tmp_path_factory.mktemp("cache")))
        for name in ("RAYS", "DIRECT_SAMPLES"):  # one round is as exact as tests need
            patch.setattr(ambient, name, 16)
        scene = chair(folder)
        return folder, {name: make(scene) for name, make in KINDS.items()}


@pytest.fixture
def nothing_made(monkeypatch):
    for module, names in MAKERS.items():
        for name in names:
            path = f"periscopy_sim.{module}.{name}"
            monkeypatch.setattr(path, lambda *_, **__: pytest.fail("made again"))


@pytest.mark.usefixtures("jit", "nothing_made")
def test_another_process_reads_what_a_folder_keeps(kept):
    folder, made = kept
    scene = pickle.loads(pickle.dumps(chair(folder)))
    for name, make in KINDS.items():
        np.testing.assert_array_equal(make(scene), made[name], name)


@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("damage", [lambda data: data[:-100], lambda _: b"PK" * 999])
def test_a_damaged_file_is_made_anew(damage, kept, tmp_path):
    for file in kept[0].iterdir():
        (tmp_path / file.name).write_bytes(damage(file.read_bytes()))
    scene = chair(tmp_path)
    np.testing.assert_array_equal(scene.A, kept[1]["A"])
    assert np.allclose(KINDS["photograph"](scene), kept[1]["photograph"])
    assert np.array_equal(chair(tmp_path).A, kept[1]["A"])


@pytest.mark.usefixtures("jit")
def test_what_another_version_or_variant_kept_is_not_taken(kept, monkeypatch):
    files = {*kept[0].iterdir()}
    monkeypatch.setattr(memos, "_renderer", lambda: "of other code")
    assert np.array_equal(chair(kept[0]).A, kept[1]["A"])
    assert {*kept[0].iterdir()} > files


def test_a_full_disk_and_a_place_that_cannot_be_written_are_one_error(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    make = Maker()
    with pytest.raises(OutputError, match="file"):
        Memo(folder=tmp_path / "file" / "kept").get("a", make, kind=np.ndarray)
    assert make.calls == 0  # before hours of work

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OutputError, match="the disk is full"):
        Memo(folder=tmp_path / "kept").get("a", lambda: np.ones(3), kind=np.ndarray)
    assert not [*tmp_path.rglob("*.npz")]


SHARED = """
import sys
import numpy as np
from periscopy_sim.memo import Memo
for key in range(20):
    memo = Memo(folder=sys.argv[1])
    made = memo.get(key, lambda: np.full((500, 500), float(key)), kind=np.ndarray)
    assert (made == key).all() and made.shape == (500, 500)
"""


def test_processes_share_a_folder(tmp_path):
    command = [sys.executable, "-c", SHARED, str(tmp_path)]
    running = [subprocess.Popen(command) for _ in range(2)]
    assert [each.wait() for each in running] == [0, 0]
    assert len([*tmp_path.iterdir()]) == 20


@pytest.fixture
def rendered(monkeypatch):
    """Replace rendering by random numbers, for a list of the scenes that were rendered."""
    calls = []

    def render(path, scenario, *, target, seed, **_):
        calls.append(path.stem)
        rng = np.random.default_rng([seed, len(calls)])
        picture = rng.uniform(1, 2, (*scenario.photograph_shape, 3))
        return ambient.Background(picture, target, 0.0)

    monkeypatch.setattr(ambient, "render_background", render)
    return calls


def test_light_is_rendered_once_for_a_wall_whatever_stands_before_it(rendered, tmp_path):
    first = chair().ambient(OVERCAST)
    for scene in (chair(occluder_dx=0.01), chair(monitor_dx=0.01), chair(tmp_path / "own")):
        assert not scene.missing_ambient(["overcast"])
        found = scene.ambient("overcast")
        assert np.array_equal(found.photograph, first.photograph) and found.relative_error == 3e-4
    assert rendered == ["overcast"]
    assert len([*tmp_path.rglob("*.npz")]) == 1  # the cache may forget it


def test_all_that_light_depends_on_makes_another(rendered):
    scene, coarse = chair(), chair(resolution="14")
    for each, options in [
        (scene, {}), (coarse, {}), (replace(scene, seed=1), {}), (scene, {"target": 1e-3}),
    ]:  # fmt: skip
        each.ambient("overcast", **options)
    scene.ambient("snow")
    assert len(rendered) == 5


def test_a_damaged_or_unwritable_cache_costs_time_alone(rendered, user_cache, monkeypatch):
    whole = chair().ambient("overcast")
    (file,) = user_cache.rglob("*.npz")
    file.write_bytes(file.read_bytes()[:-100])
    again = chair().ambient("overcast")
    assert len(rendered) == 2 and not np.array_equal(whole.photograph, again.photograph)
    assert np.array_equal(chair().ambient("overcast").photograph, again.photograph)
    (user_cache / "taken").touch()
    monkeypatch.setenv("PERISCOPY_DATA", str(user_cache / "taken"))
    for count in (3, 4):
        chair().ambient("overcast")
        assert len(rendered) == count


def test_the_cache_is_bounded_and_forgets_what_is_not_used(rendered, user_cache, monkeypatch):
    def light(seed):
        replace(chair(), seed=seed).ambient("overcast")

    for seed in range(3):
        light(seed)
    sizes = [file.stat().st_size for file in user_cache.rglob("*.npz")]
    monkeypatch.setattr(memos, "LIGHT_BYTES", 3.5 * max(sizes))
    light(0)
    light(3)  # in the place of 1
    lacking = [bool(replace(chair(), seed=s).missing_ambient(["overcast"])) for s in range(4)]
    assert lacking == [False, True, False, False] and len(rendered) == 4


@pytest.mark.usefixtures("jit")
def test_a_photograph_may_be_written_into():
    scene, image = chair(), np.ones((4, 5, 3))
    first = scene.photograph(image, bounces=1).values.copy()
    scene.photograph(image, bounces=1).values[:] = 0
    assert np.array_equal(scene.photograph(image, bounces=1).values, first)
