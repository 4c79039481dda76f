import sys
import warnings
from types import ModuleType, SimpleNamespace

import pytest

from periscopy_sim.errors import VariantError
from periscopy_sim.rendering.variant import (
    OVERRIDE,
    examine_variants,
    use_variant,
)

INSTALLED = ["scalar_rgb", "scalar_spectral", "llvm_ad_rgb", "llvm_ad_mono", "cuda_ad_rgb"]


class Backends:
    """Stands in for Mitsuba and Dr.Jit with any backends."""

    def __init__(self, cuda=False, llvm=None, current=None):
        self.current = current
        self.events = []
        self.mitsuba = ModuleType("mitsuba")
        self.mitsuba.variant = lambda: self.current
        self.mitsuba.variants = lambda: list(INSTALLED)
        self.mitsuba.set_variant = self.set_variant
        self.drjit = ModuleType("drjit")
        self.drjit.JitBackend = SimpleNamespace(CUDA="cuda", LLVM="llvm")
        works = {"cuda": int(cuda), "llvm": int(llvm is not None)}
        self.drjit.has_backend = works.__getitem__
        self.drjit.detail = SimpleNamespace(llvm_version=lambda: (llvm, 1, 0))

    def set_variant(self, name):
        self.events.append(name)
        self.current = name


@pytest.fixture
def backends(monkeypatch):
    monkeypatch.delenv(OVERRIDE, raising=False)

    def install(**facts):
        fake = Backends(**facts)
        monkeypatch.setitem(sys.modules, "mitsuba", fake.mitsuba)
        monkeypatch.setitem(sys.modules, "drjit", fake.drjit)
        register = "periscopy_sim.rendering.emitters.lcd.register_lcd"
        monkeypatch.setattr(register, lambda: fake.events.append("plugins"))
        return fake

    return install


def refusal(name=None):
    with pytest.raises(VariantError) as caught:
        use_variant(name)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("facts", "best"),
    [
        ({"cuda": True, "llvm": 19}, "cuda_ad_rgb"),
        ({"cuda": True}, "cuda_ad_rgb"),
        ({"llvm": 17}, "llvm_ad_rgb"),
    ],
)
def test_fastest_variant_that_works_is_chosen(backends, facts, best):
    fake = backends(**facts)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert use_variant() == best
    assert fake.current == best


@pytest.mark.parametrize("llvm", [None, 14, 15, 16])
def test_scalar_is_the_last_resort_and_says_what_would_be_faster(backends, llvm):
    fake = backends(llvm=llvm)
    with pytest.warns(RuntimeWarning, match="install LLVM 17 or newer"):
        assert use_variant() == "scalar_rgb"
    assert fake.current == "scalar_rgb"


def test_argument_then_environment_then_the_users_own_then_the_fastest(backends, monkeypatch):
    backends(cuda=True, llvm=19, current="scalar_rgb")
    assert use_variant() == "scalar_rgb"
    monkeypatch.setenv(OVERRIDE, "llvm_ad_rgb")
    assert use_variant() == "llvm_ad_rgb"
    assert use_variant("cuda_ad_rgb") == "cuda_ad_rgb"
    monkeypatch.setenv(OVERRIDE, "")
    assert use_variant() == "cuda_ad_rgb"


@pytest.mark.parametrize("way", ["argument", "environment"])
def test_unknown_variant_is_refused_with_those_installed(backends, monkeypatch, way):
    fake = backends(llvm=19)
    if way == "environment":
        monkeypatch.setenv(OVERRIDE, "llvm_rgb")
    message = refusal("llvm_rgb" if way == "argument" else None)
    assert "'llvm_rgb'" in message
    assert ", ".join(INSTALLED) in message
    assert fake.events == []


def test_a_variant_that_does_not_work_here_is_refused_with_the_reason(backends):
    fake = backends()
    assert "no NVIDIA device" in refusal("cuda_ad_rgb")
    assert "; install LLVM 17 or newer" in refusal("llvm_ad_rgb")
    assert fake.events == []


CHANGE_VARIANTS = """
import mitsuba as mi
mi.set_variant("scalar_rgb")
from periscopy_sim.rendering.variant import examine_variants, is_vectorized, use_variant
for name in [None] + [report.name for report in examine_variants() if report.works]:
    used = use_variant(name)
    assert used == mi.variant() == (name or "scalar_rgb"), used
    assert is_vectorized() != used.startswith("scalar")
    shape = mi.load_dict({"type": "rectangle", "emitter": {"type": "lcd"}})
    assert "Lcd" in str(shape.emitter()), shape.emitter()
    print(used)
"""


def test_screen_plugin_loads_in_every_variant_one_after_the_other(scalar):
    working = [report.name for report in examine_variants() if report.works]
    assert scalar(CHANGE_VARIANTS).split() == ["scalar_rgb", *working]
