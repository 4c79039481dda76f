"""The tutorial's laboratory as it is shipped is the one that its script photographs."""

import pytest
import tifffile

from experiments.laboratories import tutorial
from experiments.laboratories.making import ruler
from experiments.laboratories.making.laboratories import TUTORIAL


def test_what_was_measured_is_the_rulers_reading():
    read = ruler.read_by_ruler(TUTORIAL.scene, 100 * TUTORIAL.seed)
    shipped = (tutorial.SHIPPED / "measurements.yaml").read_text("utf-8")
    assert shipped == tutorial.measurements(read)
    assert "lamp_x" in read
    assert read != {name: ruler.declared(TUTORIAL.scene)[name] for name in read}


def test_the_wall_is_dimmer_without_the_monitor():
    on, off = (
        tifffile.imread(tutorial.SHIPPED / name).astype(float) - TUTORIAL.camera.black
        for name in ("photograph.tiff", "monitor_off.tiff")
    )
    # By the SBR, up to what vignetting, the poster and the rest of the room change.
    assert (on.mean() - off.mean()) / off.mean() == pytest.approx(TUTORIAL.sbr, rel=0.15)
