"""A scene file with other defaults: all else stays, comments too."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.dom import minidom
from xml.parsers.expat import ExpatError

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene_files import comment, literal, read_document
from periscopy_sim.scene import SceneDocument


def write_copy(
    scene: SceneDocument, values: Mapping[str, str], copy: Path, remark: str = ""
) -> None:
    """Write a scene with other defaults, see `with_defaults`, to where it names the same files.

    Raises
    ------
    SceneError
        As `with_defaults`, or if a file beside the copy would be taken for one of the scene's.
    """
    write_document(with_defaults(scene, values, copy.parent, remark), copy)
    ours = [file.resolve() for file in read_document(copy).files[1:]]
    theirs = [file.resolve() for file in scene.files[1:]]
    if ours != theirs:
        other = next((file for file in ours if file not in theirs), None)
        raise SceneError(f"scene '{copy}' would take '{other}' for a file of '{scene.path}'")


def with_defaults(
    scene: SceneDocument, values: Mapping[str, str], folder: Path, remark: str = ""
) -> minidom.Document:
    """Return a scene file's XML with those given, or other values, of its ``<default>``s, by name.

    One that only an included file declares is declared before it. `folder` is where the document
    will lie: if the scene names files and lies elsewhere, a ``<path>`` to its folder is added,
    relative where that lies below, else absolute. A remark becomes the first comment.

    Raises
    ------
    SceneError
        If the file is not XML.
    """
    path, values = scene.path, {**scene.given, **values}
    try:
        document = minidom.parse(str(path))
    except ExpatError as error:
        raise SceneError(f"scene '{path}' is not XML in its encoding, UTF-8 ({error})") from None
    missing = dict(values)
    for default in document.getElementsByTagName("default"):
        name = default.getAttribute("name")
        if name in values:
            default.setAttribute("value", values[name])
            missing.pop(name, None)
    added: list[minidom.Element | minidom.Comment] = [
        element(document, "default", name=name, value=value) for name, value in missing.items()
    ]
    home, folder = path.parent.resolve(), folder.resolve()
    if home != folder and len(scene.files) > 1:
        # Forward slashes, which all systems take: a scene may travel.
        place = (home.relative_to(folder) if home.is_relative_to(folder) else home).as_posix()
        added.insert(0, element(document, "path", value=literal(place)))
    if remark:
        added.insert(0, document.createComment(f" {comment(remark)} "))
    prepend(document, document.getElementsByTagName("scene")[0], added)
    return document


def element(document: minidom.Document, tag: str, **attributes: str) -> minidom.Element:
    """Return an element without children."""
    created = document.createElement(tag)
    for name, value in attributes.items():
        created.setAttribute(name, value)
    return created


def prepend(
    document: minidom.Document,
    parent: minidom.Element,
    nodes: Sequence[minidom.Element | minidom.Comment],
) -> None:
    """Put nodes before the children of an element, each on a line of its own."""
    first = parent.firstChild
    for node in nodes:
        parent.insertBefore(document.createTextNode("\n    "), first)
        parent.insertBefore(node, first)


def scale_about(
    document: minidom.Document, shape: minidom.Element, center: Sequence[float], scale: str
) -> None:
    """Scale a shape about a point, (3,), in its scene, after all else that moves it."""
    transforms = shape.getElementsByTagName("transform")
    place = next((each for each in transforms if each.getAttribute("name") == "to_world"), None)
    if place is None:
        place = shape.appendChild(element(document, "transform", name="to_world"))
    axes = dict(zip("xyz", center, strict=True))
    away = {axis: f"{-each:.9g}" for axis, each in axes.items()}
    back = {axis: f"{each:.9g}" for axis, each in axes.items()}
    place.appendChild(element(document, "translate", **away))
    place.appendChild(element(document, "scale", value=scale))
    place.appendChild(element(document, "translate", **back))


def write_document(document: minidom.Document, path: Path) -> None:
    """Write a document as UTF-8."""
    nodes = (node.toxml() for node in document.childNodes)
    path.write_text("\n".join(nodes) + "\n", encoding="utf-8")
