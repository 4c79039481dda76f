import os
import pickle
import sys
from types import ModuleType, SimpleNamespace

import pytest

import periscopy_sim as ps
from periscopy_sim.errors import VariantError
from periscopy_sim.rendering import variant

INSTALLED = ["scalar_rgb", "scalar_spectral", "llvm_ad_rgb", "llvm_ad_mono", "cuda_ad_rgb"]


class Backends:
    """Stands in for Mitsuba and Dr.Jit with any backends."""

    def __init__(self, cuda=False, metal=False, llvm=None, current=None, installed=INSTALLED):
        self.current = current
        self.events = []
        self.mitsuba = ModuleType("mitsuba")
        self.mitsuba.variant = lambda: self.current
        self.mitsuba.variants = lambda: list(installed)
        self.mitsuba.set_variant = self.set_variant
        self.drjit = ModuleType("drjit")
        self.drjit.JitBackend = SimpleNamespace(CUDA="cuda", LLVM="llvm", Metal="metal")
        works = {"cuda": int(cuda), "metal": int(metal), "llvm": int(llvm is not None)}
        self.drjit.has_backend = works.__getitem__
        self.drjit.detail = SimpleNamespace(llvm_version=lambda: (llvm, 1, 0))

    def set_variant(self, name):
        self.events.append(name)
        self.current = name


@pytest.fixture
def backends(monkeypatch):
    monkeypatch.delenv(variant.OVERRIDE, raising=False)

    def install(**facts):
        fake = Backends(**facts)
        monkeypatch.setitem(sys.modules, "mitsuba", fake.mitsuba)
        monkeypatch.setitem(sys.modules, "drjit", fake.drjit)
        monkeypatch.setattr(variant._Renderer, "ready_for", "")
        monkeypatch.setattr(variant, "PLUGINS", [lambda _: fake.events.append("plugins")])
        return fake

    return install


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("facts", "best"),
    [
        ({"cuda": True, "llvm": 19}, "cuda_ad_rgb"),
        ({"metal": True, "llvm": 19, "installed": ["metal_ad_rgb", *INSTALLED]}, "metal_ad_rgb"),
        ({"metal": True, "llvm": 19}, "llvm_ad_rgb"),  # a Mitsuba without it
        ({"llvm": 17}, "llvm_ad_rgb"),
    ],
)
def test_fastest_variant_that_works_is_chosen(backends, facts, best):
    fake = backends(**facts)
    assert variant.use_variant() == best == fake.current


def test_a_library_that_mitsuba_lacks_is_the_users_to_install(backends, monkeypatch):
    backends()
    monkeypatch.setitem(sys.modules, "drjit", None)  # so that its import fails
    with pytest.raises(VariantError, match="drjit"):
        variant.examine_variants()


@pytest.mark.parametrize("llvm", [None, 14, 16])
def test_scalar_is_the_last_resort(backends, llvm):
    fake = backends(llvm=llvm)
    assert variant.use_variant() == "scalar_rgb" == fake.current


def test_argument_then_environment_then_the_users_own_then_the_fastest(backends, monkeypatch):
    backends(cuda=True, llvm=19, current="scalar_rgb")
    assert variant.use_variant() == "scalar_rgb"
    monkeypatch.setenv(variant.OVERRIDE, "llvm_ad_rgb")
    assert variant.use_variant() == "llvm_ad_rgb"
    assert variant.use_variant("cuda_ad_rgb") == "cuda_ad_rgb"
    monkeypatch.setenv(variant.OVERRIDE, "")
    assert variant.use_variant() == "cuda_ad_rgb"


@pytest.mark.parametrize(
    ("name", "facts", "words"),
    [
        ("llvm_rgb", {"llvm": 19}, "'llvm_rgb'.*scalar_rgb, llvm_ad_rgb, cuda_ad_rgb"),
        ("llvm_ad_mono", {"llvm": 19}, "'llvm_ad_mono'"),
        ("cuda_ad_rgb", {}, "no NVIDIA device"),
        ("llvm_ad_rgb", {}, r"pip install -e"),
    ],
)
def test_a_variant_that_does_not_work_is_refused_with_the_reason(
    backends, monkeypatch, name, facts, words
):
    fake = backends(**facts)
    with pytest.raises(VariantError, match=words):
        variant.use_variant(name)
    monkeypatch.setenv(variant.OVERRIDE, name)
    with pytest.raises(VariantError, match=words):
        variant.use_variant()
    assert fake.events == []


@pytest.mark.parametrize(
    ("files", "chosen"),
    [
        (["libLLVM.so.23.1", "libLLVM.so.19.1", "libLLVM-C.so.24"], "libLLVM-C.so.24"),
        (["libLLVM.19.1.dylib", "libLLVMAArch64Info.a", "libLLVM-15.so"], "libLLVM.19.1.dylib"),
        (["libLLVM-15.so.1", "libLLVM.so"], None),
    ],
)
def test_newest_llvm_of_the_environment_goes_before_the_systems(
    files, chosen, monkeypatch, tmp_path
):
    (tmp_path / "lib").mkdir()
    for name in files:
        (tmp_path / "lib" / name).touch()
    monkeypatch.setattr(variant.sys, "prefix", str(tmp_path))
    monkeypatch.setattr(variant.site, "getuserbase", lambda: str(tmp_path / "none"))
    environment = {key: each for key, each in os.environ.items() if key != variant.LLVM_FILE}
    monkeypatch.setattr(variant.os, "environ", environment)
    imported = variant.choose_llvm()  # Dr.Jit may be: nothing is changed then
    assert variant.LLVM_FILE not in os.environ or "drjit" not in sys.modules
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    for before in ({}, {variant.LLVM_FILE: ""}):
        environment |= before
        origin, remedy = variant.choose_llvm()
        assert (os.environ.get(variant.LLVM_FILE) or None) == (
            chosen and str(tmp_path / "lib" / chosen)
        )
        assert (chosen or "the system's") in origin and remedy == variant.INSTALL_LLVM and imported
        environment.pop(variant.LLVM_FILE, None)
    environment[variant.LLVM_FILE] = "mine.so"
    origin, remedy = variant.choose_llvm()
    assert f"{variant.LLVM_FILE}, mine.so" in origin and f"unset {variant.LLVM_FILE}" in remedy


IN_SCALAR = """
import sys
import mitsuba as mi
import periscopy_sim as ps
from periscopy_sim.errors import VariantError
from periscopy_sim.rendering.shadow_rays import RenderedTransport
scene = ps.load_scenario(sys.argv[1], (1, 1))
assert mi.variant() == "scalar_rgb" and ps.analytic_transport(scene).all()
for render in (
    lambda: ps.render_transport(scene),
    lambda: ps.render_bounced_light(scene),
    lambda: ps.render_background("ambient/overcast", scene),
    lambda: ps.render_photograph(scene, [[[1, 1, 1]]]),
    lambda: next(RenderedTransport(scene).row_blocks()),
):
    try:
        render()
    except VariantError as error:
        assert "PERISCOPY_VARIANT" in str(error) or "LLVM" in str(error)
        print("refused")
"""

MOVE_UNPICKLED = """
import mitsuba  # which chooses no variant by itself
import pickle, sys
from pathlib import Path
scene = pickle.loads(Path(sys.argv[1]).read_bytes())
print(scene.at(occluder_dx=0.01).scene.occluders[0].bounds[0, 0])
"""

CHANGE_VARIANTS = """
import mitsuba as mi
mi.set_variant("scalar_rgb")
from periscopy_sim.rendering.variant import examine_variants, use_variant
for name in [None] + [report.name for report in examine_variants() if report.works]:
    used = use_variant(name)
    assert used == mi.variant() == (name or "scalar_rgb"), used
    shape = mi.load_dict({"type": "rectangle", "emitter": {"type": "lcd"}})
    assert "Lcd" in str(shape.emitter()), shape.emitter()
    print(used)
"""


def test_closed_forms_need_no_rays_and_rays_say_what_they_need(room, scalar):
    assert scalar(IN_SCALAR, room.write()).split() == 5 * ["refused"]


def test_unpickled_scene_moves_in_a_fresh_process(scalar, tmp_path):
    scene = ps.load_scenario("plate", (1, 1), {"resolution": 4})
    (tmp_path / "scene").write_bytes(pickle.dumps(scene))
    moved = scene.at(occluder_dx=0.01).scene.occluders[0].bounds[0, 0]
    assert float(scalar(MOVE_UNPICKLED, tmp_path / "scene")) == pytest.approx(moved)


def test_screen_plugin_loads_in_every_variant_one_after_the_other(scalar):
    working = [report.name for report in variant.examine_variants() if report.works]
    assert scalar(CHANGE_VARIANTS).split() == ["scalar_rgb", *working]
