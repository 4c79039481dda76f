"""Computational periscopy: from a Mitsuba scene and a photograph of a wall to the hidden image.

The public names, listed in ``__init__.pyi``, are loaded when first used, so that importing the
package imports no renderer.
"""

import lazy_loader

try:
    __getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
except ValueError:
    raise ImportError(f"{__file__} is in an archive; unpack it, scenes are files too") from None
