"""The public names; each is loaded when first used."""

from .adapters import TorchTransport, transport_operator
from .analytic.area_transport import analytic_transport
from .analytic.point_light import paper_grid, point_light_backgrounds, point_light_response
from .calibration.calibrate import calibrate
from .calibration.moving_scene import uncertain_transport
from .calibration.occluder import OccluderEstimate, find_occluder
from .calibration.result import Calibration
from .calibration.silhouette import Silhouette, recover_silhouette
from .dataset.configuration import load_configuration
from .dataset.make import make_dataset
from .dataset.reading import TorchDataset, open_dataset
from .errors import PeriscopyError
from .evaluation.design import analyze, design, diagnose
from .evaluation.metrics import (
    colour_matched_psnr,
    gain_matched,
    mean_squared_error,
    psnr,
    psnr_gain_matched,
    registered,
)
from .evaluation.study import sweep
from .evaluation.sweep import Sweep, World, flips, run_sweep
from .figures.display import save_png, show, to_srgb
from .figures.laboratory import draw
from .hidden import Hidden, Surface
from .laboratory.document import build_laboratory, lab
from .light import Light
from .live.watch import watch
from .measurement import add_noise, composite
from .methods import find_method
from .model.uncertainty import UncertainTransport
from .photograph import ColourMatrix, Photograph
from .photographs.develop import defective_pixels, develop
from .photographs.prepare import Prepared, prepare
from .photographs.wall_view import WallPoints, WallTags
from .reconstruction.differencing import Differencing
from .reconstruction.noise_aware import NoiseAware, NoiseAwareReconstruction, NoiseAwareVideo
from .reconstruction.noise_aware_views import NoiseAwareViews
from .reconstruction.preconditioned import (
    Periscope,
    Preconditioner,
    Reconstruction,
    Video,
    form_preconditioner,
    repair,
)
from .reconstruction.total_variation import prox_total_variation
from .reconstruction.truncated_svd import TruncatedSVD
from .rendering.ambient import Background, render_background
from .rendering.bounced import BouncedLight, BouncedTransport, add_bounces, render_bounced_light
from .rendering.load import load_scene
from .rendering.photograph import render_photograph
from .rendering.shadow_rays import render_transport
from .rendering.transport import transport
from .rendering.variant import use_variant
from .scenario import Scenario, load_scenario
from .scene import Scene
from .shipped import find_image, find_scene
from .storage.photographs import open_frames, read_mask, read_photograph, read_sensor_image
from .storage.pictures import read_hidden_image
from .storage.published import fetch
from .storage.tables import read_colour_matrix, read_wall_points, read_wall_tags
from .view import View

__all__ = [
    "Background",
    "BouncedLight",
    "BouncedTransport",
    "Calibration",
    "ColourMatrix",
    "Differencing",
    "Hidden",
    "Light",
    "NoiseAware",
    "NoiseAwareReconstruction",
    "NoiseAwareVideo",
    "NoiseAwareViews",
    "OccluderEstimate",
    "Periscope",
    "PeriscopyError",
    "Photograph",
    "Preconditioner",
    "Prepared",
    "Reconstruction",
    "Scenario",
    "Scene",
    "Silhouette",
    "Surface",
    "Sweep",
    "TorchDataset",
    "TorchTransport",
    "TruncatedSVD",
    "UncertainTransport",
    "Video",
    "View",
    "WallPoints",
    "WallTags",
    "World",
    "add_bounces",
    "add_noise",
    "analytic_transport",
    "analyze",
    "build_laboratory",
    "calibrate",
    "colour_matched_psnr",
    "composite",
    "defective_pixels",
    "design",
    "develop",
    "diagnose",
    "draw",
    "fetch",
    "find_image",
    "find_method",
    "find_occluder",
    "find_scene",
    "flips",
    "form_preconditioner",
    "gain_matched",
    "lab",
    "load_configuration",
    "load_scenario",
    "load_scene",
    "make_dataset",
    "mean_squared_error",
    "open_dataset",
    "open_frames",
    "paper_grid",
    "point_light_backgrounds",
    "point_light_response",
    "prepare",
    "prox_total_variation",
    "psnr",
    "psnr_gain_matched",
    "read_colour_matrix",
    "read_hidden_image",
    "read_mask",
    "read_photograph",
    "read_sensor_image",
    "read_wall_points",
    "read_wall_tags",
    "recover_silhouette",
    "registered",
    "render_background",
    "render_bounced_light",
    "render_photograph",
    "render_transport",
    "repair",
    "run_sweep",
    "save_png",
    "show",
    "sweep",
    "to_srgb",
    "transport",
    "transport_operator",
    "uncertain_transport",
    "use_variant",
    "watch",
]
