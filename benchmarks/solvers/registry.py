"""Every method of the package's registry, by its name and with its own defaults."""

from __future__ import annotations

from typing import Any

from benchmarks.entry import Entry, Recover
from periscopy_sim.reconstruction.registry import METHODS


class Solver(Entry):
    """A method of `periscopy_sim.reconstruction.registry`."""

    name = "registry"
    parameters = {"method": [*METHODS]}  # noqa: RUF012

    @property
    def label(self) -> str:
        """The method's own name."""
        return str(self.method)

    def fit(self, scene: Any, A: Any, B: Any) -> Any:
        """Fit it as a sweep does."""
        return METHODS[self.method](scene, A, B)

    def frames(self, method: Any) -> Recover:
        """Return its own way with videos, by its first coupling, where it has one."""
        video = METHODS[self.method].video
        if video is None:
            return super().frames(method)
        recover: Recover = METHODS[self.method].frames_by(method, video.couplings[0]).next_frame
        return recover
