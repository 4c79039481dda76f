"""Where the scenes and hidden images that come with the package lie."""

from pathlib import Path
from typing import Any

from periscopy_sim import errors
from periscopy_sim.numerics.validation import is_name

REALISTIC = (
    "high_sun", "low_sun", "overcast", "window_left", "window_right", "ceiling_panels",
    "desk_lamps", "corridor",
)  # fmt: skip
"""Ambient scenes in which no edge of direct sun crosses the field of view."""

ADVERSARIAL = ("stained_glass", "snow")
"""Ambient scenes made to break the model of ambient light, as in the paper's Fig. 5."""

CONDITIONS = (*REALISTIC, *ADVERSARIAL)
"""All ambient scenes."""

DARK = "none"
"""Names the lack of ambient light."""


def scenes_folder() -> Path:
    """Return the folder of shipped scenes: inside an installed package, beside it in a checkout."""
    package = Path(__file__).parent
    for folder in (package / "scenes", package.parent / "scenes"):
        if (folder / "chair.xml").is_file():
            return folder
    raise errors.SceneError("the shipped scenes are missing; install periscopy_sim again")


def find_scene(name: str | Path) -> Path:
    """Return an existing scene file: a path, or else the name of a shipped scene.

    Names are ``chair``, ``scenes/chair.xml`` or ``ambient/ceiling_panels``. A SceneError lists what
    there is.
    """
    return _find(name, "", ".xml", "scene", errors.SceneError)


def find_image(name: str | Path) -> Path:
    """Return an existing picture: a path, or else the name of a shipped one, ``mushroom`` say.

    A PhotographError lists what there is.
    """
    return _find(name, "images", ".png", "image", errors.PhotographError)


def find_condition(name: str | Path) -> Path:
    """Return the file of a shipped ambient scene, ``overcast`` say, or the scene file named."""
    if str(name) in CONDITIONS:
        return find_scene(f"ambient/{name}")
    if Path(name).suffix == ".xml" and Path(name).is_file():
        return Path(name)
    guess = errors.did_you_mean(str(name), CONDITIONS) or f"there are {', '.join(CONDITIONS)}."
    raise errors.PeriscopyError(
        f"no ambient condition '{name}'; {guess} Or name a Mitsuba XML file"
    )


def is_photograph(light: Any) -> bool:
    """Return whether light is a photograph, or its file, rather than a condition's name."""
    return not is_name(light) or (Path(light).suffix != ".xml" and Path(light).is_file())


def _find(
    name: str | Path, subfolder: str, suffix: str, what: str, error: type[errors.PeriscopyError]
) -> Path:
    try:
        is_file = (path := Path(name)).is_file()
    except TypeError:
        kind = type(name).__name__
        raise error(f"the {what} is of type {kind}; name a file or a shipped {what}") from None
    except (OSError, ValueError) as reason:  # no file system has such a name
        text = getattr(reason, "strerror", None) or reason
        raise error(f"{what} '{name}': {text}; name a file or a shipped {what}") from None
    place = path.absolute() if is_file else path
    if fault := errors.path_fault(place):
        raise error(f"{what} '{place}' {fault}")
    if is_file:
        return path
    folder = scenes_folder() / subfolder
    # Also as the checkout's own paths: scenes/chair.xml, scenes/images/mushroom.png.
    inside = [part for part in path.parts if part not in ("scenes", subfolder)]
    shipped = folder.joinpath(*inside).with_suffix(suffix)
    named = path.suffix in ("", suffix) and ".." not in inside and not path.is_absolute()
    if named and shipped.is_file():
        return shipped
    files = *sorted(folder.glob(f"*{suffix}")), *sorted(folder.glob(f"ambient/*{suffix}"))
    names = [str(file.relative_to(folder).with_suffix("")) for file in files]
    problem = "is a folder or no regular file" if path.exists() else "does not exist"
    raise error(
        f"{what} '{path}' {problem}; {errors.did_you_mean(str(path), names)} name a file or a "
        f"shipped {what}: {', '.join(names)}"
    )
