"""The public names; each is loaded when first used."""

from .analytic.point_light import (
    paper_grid,
    point_light_backgrounds,
    point_light_response,
)
from .analytic.transport import analytic_transport
from .calibration.calibrating import Calibration, calibrate
from .dataset.configuration import load_configuration
from .dataset.making import make_dataset
from .dataset.reading import open_dataset
from .dataset.torch_dataset import TorchDataset
from .defects import defective_pixels
from .errors import PeriscopyError
from .evaluation.diagnostics import diagnose
from .evaluation.methods import find_method
from .evaluation.metrics import gain_matched, mean_squared_error, psnr, registered
from .evaluation.sweep import Sweep, flips, run_sweep
from .measurement import Sensor, add_noise, composite
from .reconstruction.baselines import Differencing, TruncatedSVD
from .reconstruction.iterative import IterativePeriscope, IterativeReconstruction
from .reconstruction.noise_aware import NoiseAware, NoiseAwareReconstruction
from .reconstruction.noise_aware_video import NoiseAwareVideo
from .reconstruction.periscope import Periscope, Reconstruction
from .reconstruction.portable import PortablePeriscope
from .reconstruction.preconditioner import Preconditioner, form_preconditioner
from .reconstruction.repair import repair
from .reconstruction.total_variation import prox_total_variation
from .reconstruction.video import Video
from .rendering.ambient import Background, render_background
from .rendering.photograph import render_photograph
from .rendering.scene_file import load_scenario
from .rendering.transport import render_transport
from .rendering.variant import use_variant
from .scenario import Scenario
from .shipped import find_image, find_scene
from .storage.frames import open_frames
from .storage.masks import read_mask
from .storage.photographs import read_photograph
from .storage.pictures import read_hidden_image

__all__ = [
    "Background",
    "Calibration",
    "Differencing",
    "IterativePeriscope",
    "IterativeReconstruction",
    "NoiseAware",
    "NoiseAwareReconstruction",
    "NoiseAwareVideo",
    "Periscope",
    "PeriscopyError",
    "PortablePeriscope",
    "Preconditioner",
    "Reconstruction",
    "Scenario",
    "Sensor",
    "Sweep",
    "TorchDataset",
    "TruncatedSVD",
    "Video",
    "add_noise",
    "analytic_transport",
    "calibrate",
    "composite",
    "defective_pixels",
    "diagnose",
    "find_image",
    "find_method",
    "find_scene",
    "flips",
    "form_preconditioner",
    "gain_matched",
    "load_configuration",
    "load_scenario",
    "make_dataset",
    "mean_squared_error",
    "open_dataset",
    "open_frames",
    "paper_grid",
    "point_light_backgrounds",
    "point_light_response",
    "prox_total_variation",
    "psnr",
    "read_hidden_image",
    "read_mask",
    "read_photograph",
    "registered",
    "render_background",
    "render_photograph",
    "render_transport",
    "repair",
    "run_sweep",
    "use_variant",
]
