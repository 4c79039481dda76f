from tests.scenes.silhouette import (  # noqa: F401 (fixtures)
    empty,
    flagged,
    images,
    photographs,
    plane,
    scenario,
    scene,
)
