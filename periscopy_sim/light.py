"""How the light of a scenario is computed: what A and B are made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics import Image, validation

if TYPE_CHECKING:
    from periscopy_sim.rendering.bounced import BouncedTransport
    from periscopy_sim.rendering.shadow_rays import Strata
    from periscopy_sim.rendering.transport import By


@dataclass(frozen=True, eq=False)
class Light:
    """How the light of a scenario is computed.

    Attributes
    ----------
    by
        ``"areas"`` or ``"rays"``; None takes areas where the scene has them.
    samples
        Rays from the centre of each pixel to each patch; None lets the photographs' noise decide.
    bounces
        Most reflections of a path in A: 1 is direct light, None any number.
    ambient
        The columns of B, (M, L) arrays side by side; None stands for Eq. 4 on the paper's grid.
    strata
        How rays spread over a patch, see `render_transport`.
    matrix, record
        A of your own in place of a computed one, and what its file says of its origin. It is of the
        scene's present values: `Scenario.at` rejects it.
    """

    by: "By | None" = None
    samples: int | None = None
    bounces: int | None = 1
    ambient: tuple[Image | None, ...] = (None,)
    strata: "Strata" = "jittered"
    matrix: "NDArray[Any] | BouncedTransport | None" = None
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.by not in (None, "areas", "rays"):
            raise PeriscopyError(
                f"by '{self.by}': light comes by areas or by rays, or None chooses"
            )
        if self.matrix is not None and (self.by, self.samples) != (None, None):
            raise PeriscopyError(
                "samples and by choose how A is computed; leave them out beside a matrix"
            )
        if self.samples is not None:
            validation.checked("samples", self.samples, "rays")
        if self.bounces is not None:
            validation.checked("bounces", self.bounces, "bounces")

    @property
    def computed(self) -> "Light":
        """The same without a matrix of your own, which is of one scene alone."""
        return replace(self, matrix=None, record={})

    @property
    def prototypes(self) -> list[str]:
        """Digests of the columns of B, for a record; ``grid`` for Eq. 4."""
        from periscopy_sim.storage.provenance import array_sha256

        return ["grid" if B is None else array_sha256(B) for B in self.ambient]
