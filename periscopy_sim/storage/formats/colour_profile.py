"""What a picture's colour profile says of its values: linear, or encoded by the sRGB curve."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.srgb import srgb_encode

LINEAR, SRGB = "linear", "sRGB"

CLOSE = 3
"""Of 255: profiles round their curves."""

STEEP = 32
"""Of 255: LittleCMS limits the slope of a linear profile's curve to sRGB below."""


def encoding_of(profile: bytes, path: Path) -> str:
    """Return `LINEAR` or `SRGB`: what greys are to an ICC profile; another curve is refused.

    A grey ramp is taken through the profile to sRGB, by LittleCMS. It stays as it is if the
    profile's curve is sRGB's, and comes out encoded if the profile is linear. A PhotographError
    names another profile, or one that cannot be read.
    """
    from PIL import Image, ImageCms

    try:
        opened = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        name = ImageCms.getProfileDescription(opened).strip()
        mode = "L" if opened.profile.xcolor_space.strip() == "GRAY" else "RGB"
        to_srgb = ImageCms.buildTransform(opened, ImageCms.createProfile("sRGB"), mode, "RGB")
        ramp = np.arange(256, dtype=np.uint8)
        grey = Image.fromarray(ramp[None]).convert(mode)
        shown = np.asarray(ImageCms.applyTransform(grey, to_srgb), np.float64)[0].mean(axis=1)
    except (ImageCms.PyCMSError, OSError, ValueError) as error:
        raise PhotographError(
            f"{path}: its colour profile cannot be read ({error}); save it without one, as "
            "linear light"
        ) from error
    if np.abs(shown - ramp).max() <= CLOSE:
        return SRGB
    if np.abs(shown - 255 * srgb_encode(ramp / 255))[STEEP:].max() <= CLOSE:
        return LINEAR
    raise PhotographError(
        f"{path}: its colour profile '{name}' encodes light by a curve other than sRGB's; export "
        "it with a linear profile, or with none and linear values"
    )
