"""The meshes and hidden images under ``scenes`` are what their scripts and README say."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

SCENES = Path(__file__).parents[1] / "scenes"
MESH_PARTS = {"plant": 15}
IMAGE_NAMES = [
    "bars",
    "checker",
    "digits",
    "letters",
    "mushroom",
    "siemens",
    "still_life",
    "sunset",
]

Array = NDArray[np.float64]


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCENES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def read_ply(name: str) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and triangles of a binary PLY file that holds nothing else."""
    header, body = (SCENES / "meshes" / f"{name}.ply").read_bytes().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    assert "format binary_little_endian 1.0" in lines
    assert [line for line in lines if line.startswith("property")] == [
        "property float x",
        "property float y",
        "property float z",
        "property list uchar int vertex_indices",
    ]
    vertices = np.frombuffer(body, "<f4", 3 * counts["vertex"]).reshape(-1, 3)
    face = np.dtype([("corners", "u1"), ("index", "<i4", 3)])
    faces = np.frombuffer(body, face, counts["face"], offset=vertices.nbytes)
    assert len(body) == vertices.nbytes + faces.nbytes
    assert (faces["corners"] == 3).all()
    return vertices.astype(np.float64), faces["index"].astype(np.int64)


def welded(vertices: Array, triangles: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """The same mesh with equal vertices merged."""
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    return unique, index.ravel()[triangles]


def parts(name: str) -> list[Array]:
    """Corners (n, 3, 3) of the triangles of each connected component, equal vertices merged."""
    vertices, triangles = welded(*read_ply(name))
    edges = triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(len(vertices), len(vertices)))
    count, label = connected_components(graph, directed=False)
    return [vertices[triangles[label[triangles[:, 0]] == i]] for i in range(count)]


def volume(corners: Array) -> float:
    """Volume enclosed by triangles (n, 3, 3), by the divergence theorem."""
    a, b, c = corners.swapaxes(0, 1)
    return float(np.einsum("ni,ni", a, np.cross(b, c)) / 6)


def is_convex(corners: Array) -> bool:
    """Whether no corner lies in front of any triangle's plane, to a micrometre."""
    a, b, c = corners.swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vertices = np.unique(corners.reshape(-1, 3), axis=0)
    heights = normals @ vertices.T - np.einsum("ni,ni->n", normals, a)[:, None]
    return bool(heights.max() < 1e-6)


def srgb_to_linear(image: NDArray[np.uint8]) -> Array:
    v = image / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def image(name: str) -> NDArray[np.uint8]:
    with Image.open(SCENES / "images" / f"{name}.png") as picture:
        assert picture.mode == "RGB"
        return np.asarray(picture)


def patches(name: str) -> Array:
    """Linear image (29, 36, 3), averaged over each patch."""
    averaged: Array = srgb_to_linear(image(name)).reshape(29, 10, 36, 10, 3).mean(axis=(1, 3))
    return averaged


def test_folders_hold_exactly_what_the_scripts_write_and_the_readme_lists() -> None:
    readme = (SCENES / "README.md").read_text()
    meshes = sorted(path.name for path in (SCENES / "meshes").iterdir())
    images = sorted(path.name for path in (SCENES / "images").iterdir())
    assert meshes == sorted(f"{name}.ply" for name in script("make_meshes").MESHES)
    assert meshes == [f"{name}.ply" for name in MESH_PARTS]
    assert images == sorted(f"{name}.png" for name in script("make_images").IMAGES)
    assert images == [f"{name}.png" for name in IMAGE_NAMES]
    assert all(f"`meshes/{name}`" in readme for name in meshes)
    assert all(f"`images/{name}`" in readme for name in images)


@pytest.mark.parametrize("name", MESH_PARTS)
def test_committed_mesh_is_what_the_script_builds(name: str) -> None:
    pytest.importorskip("trimesh")
    vertices, triangles = read_ply(name)
    built = script("make_meshes").build(name)
    np.testing.assert_allclose(vertices, built.vertices, rtol=0, atol=1.1e-6)
    np.testing.assert_array_equal(triangles, built.faces)


@pytest.mark.parametrize("name", MESH_PARTS)
def test_every_edge_joins_two_triangles_that_agree_on_which_side_is_out(name: str) -> None:
    _, triangles = welded(*read_ply(name))
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward = {tuple(edge) for edge in edges.tolist()}
    assert len(forward) == len(edges)
    assert forward == {(b, a) for a, b in forward}
    assert all(volume(part) > 0 for part in parts(name))


@pytest.mark.parametrize(("name", "count"), MESH_PARTS.items())
def test_parts_stay_apart_when_equal_vertices_are_welded(name: str, count: int) -> None:
    assert len(parts(name)) == count
    vertices, _ = read_ply(name)
    assert len(np.unique(vertices, axis=0)) == len(vertices)


def test_plant_stands_on_its_origin_and_has_the_stated_size() -> None:
    vertices, triangles = read_ply("plant")
    width, _, height = np.ptp(vertices, axis=0)
    assert width == pytest.approx(0.16, abs=0.01)
    assert height == pytest.approx(0.22, abs=0.005)
    assert vertices[:, 2].min() == 0
    foot = vertices[vertices[:, 2] == 0]
    np.testing.assert_allclose(foot.mean(axis=0), 0, atol=1e-6)
    assert 3_000 <= len(triangles) <= 20_000
    assert not any(is_convex(part) for part in parts("plant"))


def test_vase_is_turned_on_a_lathe_with_a_waist_under_its_rim() -> None:
    vase = max(parts("plant"), key=volume).reshape(-1, 3)
    radius = np.hypot(vase[:, 0], vase[:, 1])
    heights = np.unique(vase[:, 2])
    turned = radius > 0.001
    outline = np.array([radius[turned & (vase[:, 2] == z)].max() for z in heights[:-1]])
    for z, r in zip(heights[:-1], outline, strict=True):
        around = radius[turned & (vase[:, 2] == z)]
        assert np.all((np.abs(around - r) < 2e-6) | (around < r - 0.001)), z
    waist = outline[(heights[:-1] > 0.03) & (heights[:-1] < 0.065)].min()
    assert waist < 0.7 * outline[heights[:-1] < 0.03].max()
    assert waist < 0.8 * outline[-3:].max()


def test_leaves_are_thin() -> None:
    leaves = sorted(parts("plant"), key=len)[7:14]
    for leaf in leaves:
        a, b, c = leaf.swapaxes(0, 1)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        assert 0.0004 < volume(leaf) / (area / 2) < 0.001
        assert np.ptp(leaf.reshape(-1, 3), axis=0).max() > 0.03


def test_plants_front_silhouette_has_gaps_and_edges_of_every_direction() -> None:
    vertices, triangles = read_ply("plant")
    pixels = (vertices[:, [0, 2]] * [1, -1] + [0.09, 0.23]) * 4000
    page = Image.new("1", (720, 960))
    draw = ImageDraw.Draw(page)
    for corners in pixels[triangles]:
        draw.polygon([tuple(corner) for corner in corners], fill=1)
    silhouette = np.asarray(page)
    assert ndimage.label(silhouette)[1] == 1
    gaps, count = ndimage.label(~silhouette)
    sizes = np.bincount(gaps.ravel())[1:]
    assert count > 1 and (sizes > 400).sum() >= 3  # the outside and gaps of at least 25 mm^2
    smooth = ndimage.gaussian_filter(silhouette.astype(float), 3)
    gx, gy = ndimage.sobel(smooth, 1), ndimage.sobel(smooth, 0)
    angle, strength = np.arctan2(gy, gx), np.hypot(gx, gy)
    share, _ = np.histogram(angle, bins=8, range=(-np.pi, np.pi), weights=strength)
    assert share.min() > 0.05 * share.sum()


@pytest.mark.thorough
@pytest.mark.parametrize("name", IMAGE_NAMES)
def test_committed_image_is_what_the_script_draws(name: str) -> None:
    images = script("make_images")
    drawn = images.encode(images.IMAGES[name]())
    assert drawn.shape == (290, 360, 3)
    assert np.abs(drawn.astype(int) - image(name)).max() <= 1


@pytest.mark.parametrize("name", IMAGE_NAMES)
def test_image_keeps_its_contrast_at_29_by_36_patches(name: str) -> None:
    brightness = patches(name).max(axis=-1)
    assert np.percentile(brightness, 95) > 0.4
    assert np.percentile(brightness, 5) < 0.1


def test_pixels_are_averaged_in_linear_light() -> None:
    images = script("make_images")
    half = images.canvas()
    half[::2] = 1.0
    assert np.all(images.encode(half) == 188)  # sRGB of one half; averaging codes would give 128


def test_bars_fill_whole_patches() -> None:
    blocks = image("bars").reshape(29, 10, 36, 10, 3)
    assert np.all(np.ptp(blocks, axis=(1, 3)) == 0)


def test_digits_light_the_segments_of_2_5_and_7() -> None:
    lit = image("digits").max(axis=-1) > 128
    # Middles of segments a to g within a digit, in tenths of a patch from its upper-left corner.
    middles = [(12, 45), (55, 78), (155, 78), (198, 45), (155, 12), (55, 12), (105, 45)]
    shown = [
        "".join(s for s, (y, x) in zip("abcdefg", middles, strict=True) if lit[40 + y, left + x])
        for left in (20, 135, 250)
    ]
    assert shown == ["abdeg", "acdfg", "abc"]


def test_siemens_star_has_eight_sectors_of_equal_width() -> None:
    angles = np.linspace(0, 2 * np.pi, 3600, endpoint=False)
    rows = np.round(144.5 + 100 * np.sin(angles)).astype(int)
    columns = np.round(179.5 + 100 * np.cos(angles)).astype(int)
    bright = image("siemens")[rows, columns, 0] > 128
    assert np.count_nonzero(bright != np.roll(bright, 1)) == 16
    assert bright.mean() == pytest.approx(0.5, abs=0.02)
