import gc
import os
import signal

import pytest

from periscopy_sim.rendering.variant import choose_llvm, examine_variants

# Small matrices on busy cores: OpenBLAS's threads would mostly wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

choose_llvm()  # some tests import Mitsuba first

# A shell's background jobs ignore Ctrl-C, and so would the programs that tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def jit():
    """Skip where only the scalar variant works: rendering would crawl, and warn that it does."""
    reports = [report for report in examine_variants() if not report.name.startswith("scalar")]
    if not any(report.works for report in reports):
        pytest.skip("; ".join(f"{report.name}: {report.reason}" for report in reports))


@pytest.fixture(scope="session")
def built_scenes():
    """Return a list that grows by each scene that is built."""
    from periscopy_sim.rendering.nodes import SceneNodes

    built, instantiate = [], SceneNodes.instantiate

    def noted(nodes):
        built.append(nodes.path)
        return instantiate(nodes)

    gc.collect()
    gc.freeze()  # what is imported stays, and need not be looked at
    gc.set_threshold(50_000, 20)  # a test's scenes stay young until the next one
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SceneNodes, "instantiate", noted)
        yield built


@pytest.fixture(scope="module", autouse=True)
def _no_scenes_of_other_modules(built_scenes):
    """Free those of a module's fixtures; see below."""
    if any(built_scenes):
        gc.collect()
    built_scenes.clear()


@pytest.fixture(autouse=True)
def _no_scenes_of_other_tests(built_scenes):
    """Free the scenes of earlier tests, which are in cycles.

    Dr.Jit makes a kernel for all shapes that live. Among others it compiles, for a second, one that
    it has compiled before.
    """
    if built_scenes and built_scenes[-1]:
        gc.collect(1)
        built_scenes.append(None)


@pytest.fixture(scope="session", autouse=True)
def _no_sync():
    """Leave files to the system: thousands would be forced to the disk, which no test cuts off."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _coarse_space():
    """Draw scenes in space by fewer rays, as seen from the best of fewer rays, too."""
    from periscopy_sim.figures import space

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(space, "PIXELS", 120)
        patch.setattr(space, "LOOK", space.LOOK[::4])
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_user_cache(tmp_path_factory):
    """Keep fixtures that tests share out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PERISCOPY_DATA", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def user_cache(tmp_path_factory, monkeypatch):
    """Give each test a cache of its own: some trace fewer paths."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("PERISCOPY_DATA", str(folder))
    return folder


@pytest.fixture(scope="module")
def quick_light():
    """Take fewer wall points in a pixel, which cost small photographs most, and bounced paths."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("periscopy_sim.analytic.area_transport.PIXEL_POINTS", 24)
        patch.setattr("periscopy_sim.rendering.bounced.PATHS", 64)
        patch.setattr("periscopy_sim.rendering.wall_polynomials.POWERS", (0, 1, 2, 3, 5))
        for module in ("ambient", "bounced"):
            patch.setattr(f"periscopy_sim.rendering.{module}.REPLICAS", 3)
        yield


@pytest.fixture
def drawings():
    """Ask for figures as they are, where a test is about them; see `blank_figures`."""


@pytest.fixture
def blank_figures(request, monkeypatch):
    """Save matplotlib's figures empty and tiny, with their metadata, but for tests of `drawings`.

    To draw them takes most of the time of most commands and experiments in small.
    """
    if "drawings" in request.fixturenames:
        return
    from matplotlib.figure import Figure

    monkeypatch.setattr("periscopy_sim.figures.style._frame", lambda *_: None)
    monkeypatch.setattr("periscopy_sim.figures.space._met", lambda *_: iter(()))
    save = Figure.savefig

    def save_blank(_, path, *, dpi="figure", metadata=None, bbox_inches=None):  # noqa: ARG001
        save(Figure(figsize=(0.1, 0.1)), path, metadata=metadata)

    monkeypatch.setattr(Figure, "savefig", save_blank)
