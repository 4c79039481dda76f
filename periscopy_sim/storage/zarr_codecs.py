"""Zarr's compressors, but none unpacks more than its chunk holds: damaged ones fill the memory."""

from typing import Any

import numpy as np
from zarr import config
from zarr.codecs import BloscCodec, GzipCodec, ZstdCodec
from zarr.registry import register_codec

from periscopy_sim.storage.rasters import check_inflated

HEADS = 4096
"""Bytes that compressors may add to a chunk, if there are several of them."""


class _Bounded:
    """A compressor that first unpacks into the space of a chunk, where larger contents fail."""

    async def _decode_single(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        space = np.empty(chunk_spec.shape, chunk_spec.dtype.to_native_dtype()).nbytes + HEADS
        packed = chunk_bytes.as_numpy_array()
        if isinstance(self, GzipCodec):
            check_inflated(packed, space, wbits=31)
        else:
            unpack = self._zstd_codec if isinstance(self, ZstdCodec) else self._blosc_codec  # type: ignore[attr-defined]
            unpack.decode(packed, np.empty(space, np.uint8))
        return await super()._decode_single(chunk_bytes, chunk_spec)  # type: ignore[misc]


CODECS = {"zstd": ZstdCodec, "blosc": BloscCodec, "gzip": GzipCodec}
for name, codec in CODECS.items():
    register_codec(name, type(name, (_Bounded, codec), {}), qualname=f"{__name__}.{name}")


def bounded_codecs() -> Any:
    """Return the context within which arrays are opened with these compressors."""
    return config.set({f"codecs.{name}": f"{__name__}.{name}" for name in CODECS})
