"""The measurements of a laboratory: a YAML file, checked before a scene is made of it."""

from pathlib import Path
from typing import Self

from pydantic import model_validator

from periscopy_sim.laboratory.bodies import AnyOccluder
from periscopy_sim.laboratory.entries import Errors
from periscopy_sim.laboratory.room import AnyCamera, AnyWall, HiddenSurface, Screen
from periscopy_sim.laboratory.scene_text import SceneText
from periscopy_sim.scene import HIDDEN, MONITOR
from periscopy_sim.storage.yaml_document import Strict, read_yaml

EXAMPLE = Path(__file__).with_name("example.yaml")


class Laboratory(Strict):
    """A laboratory as measured; ``example.yaml`` beside this file explains each entry.

    `folder`, where relative paths start, is set by `load_laboratory`.
    """

    errors: Errors = Errors()
    wall: AnyWall
    camera: AnyCamera
    monitor: Screen | None = None
    hidden: tuple[HiddenSurface, ...] = ()
    occluders: tuple[AnyOccluder, ...] = ()
    folder: Path = Path()

    @model_validator(mode="after")
    def _names_are_known_and_differ(self) -> Self:
        bearers, names, mistakes = {""}, set[str](), list[str]()
        if not (self.monitor or self.hidden):
            mistakes.append(f"no surface is hidden; give a {MONITOR}, or a list {HIDDEN}")
        surfaces = [each.name for each in self.hidden]
        if len(set(surfaces)) < len(surfaces):
            mistakes.append(f"two hidden surfaces have one name: {', '.join(surfaces)}; rename one")
        for each in self.occluders:
            if twice := each.ids & names:
                mistakes.append(f"two occluders or bars are called '{min(twice)}'; rename one")
            if each.bearer not in bearers:
                mistakes.append(
                    f"occluder '{each.name}' stands with '{each.bearer}', but no occluder above it "
                    "with axes of its own (a rod has none) is called so"
                )
            names |= each.ids
            bearers |= {each.name} if each.has_axes else set()
        if mistakes:
            raise ValueError("; ".join(mistakes))
        return self

    def scene(self, stem: str) -> SceneText:
        """Return the scene, whose file is called `stem`.

        A ConfigurationError says that the camera sees past the wall, or a mesh cannot be read.
        """
        scene = SceneText(self.errors, stem, self.folder)
        self.wall.add_to(scene, self.camera.corners_seen(self.wall))
        self.camera.add_to(scene, self.wall)
        if self.monitor is not None:
            self.monitor.add_to(scene, MONITOR)
        for surface in self.hidden:
            surface.add_to(scene, surface.id)
        to_world: dict[str, list[str]] = {"": []}  # from each occluder's own coordinates
        for body in self.occluders:
            to_world[body.name] = body.add_to(scene, to_world[body.bearer])
        return scene


def load_laboratory(path: str | Path) -> Laboratory:
    """Read the measurements of a laboratory from a YAML file like `EXAMPLE`.

    A ConfigurationError names the line where a number is missing, has no unit or is out of range.
    """
    return read_yaml(Path(path), Laboratory)
