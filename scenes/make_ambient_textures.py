"""Generate the textures in ``scenes/ambient/textures``: 8-bit sRGB PNG files.

Run ``python scenes/make_ambient_textures.py`` to write them again. All but the window, its light
and the sky tile in both directions. They are drawn in linear light; row 0 is the top.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
Colour = tuple[float, float, float]

TEXTURE_FOLDER = Path(__file__).parent / "ambient" / "textures"
SIZE = 256
"""Pixels along each side of a tile."""


def smoothstep(low: float, high: float, value: Field) -> Field:
    """Cubic ramp from 0 at ``low`` to 1 at ``high``."""
    t: Field = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def mix(start: Colour | Field, end: Colour | Field, weight: Field) -> Field:
    """Linear interpolation of colours; ``weight`` broadcasts over the channels."""
    weight = weight[..., None]
    mixed: Field = (1 - weight) * np.asarray(start) + weight * np.asarray(end)
    return mixed


def periodic(grid: Field, pixels: int, axis: int) -> Field:
    """Interpolate smoothly between values that repeat along an axis."""
    cells = grid.shape[axis]
    position = (np.arange(pixels) + 0.5) * cells / pixels
    cell = np.floor(position).astype(int)
    along = [-1 if i == axis else 1 for i in range(grid.ndim)]
    t = smoothstep(0, 1, position - cell).reshape(along)
    low, high = (grid.take(index % cells, axis) for index in (cell, cell + 1))
    between: Field = (1 - t) * low + t * high
    return between


def noise(
    cells: tuple[int, int], octaves: int, seed: int, shape: tuple[int, int] = (SIZE, SIZE)
) -> Field:
    """Tiling value noise in about [-1, 1], from (down, across) cells in the first octave on."""
    rng = np.random.default_rng(seed)
    total: Field = np.zeros(shape)
    for octave in range(octaves):
        grid = rng.uniform(-1, 1, (cells[0] * 2**octave, cells[1] * 2**octave))
        total += 0.6**octave * periodic(periodic(grid, shape[0], 0), shape[1], 1)
    return total / float(np.sqrt(sum(0.36**octave for octave in range(octaves))))


def pixel_grid(shape: tuple[int, int] = (SIZE, SIZE)) -> tuple[Field, Field]:
    """Pixel centres in [0, 1]: down (rows, 1) and across (1, columns)."""
    down, across = ((np.arange(n) + 0.5) / n for n in shape)
    return down[:, None], across[None, :]


# -- surfaces ----------------------------------------------------------------------------------


def grass() -> Field:
    """Mown lawn, 2 m of it."""
    patches, blades = noise((3, 3), 3, seed=1), noise((48, 96), 2, seed=2)
    green = mix((0.045, 0.085, 0.018), (0.11, 0.165, 0.035), 0.5 + 0.25 * patches)
    return green * (1 + 0.42 * blades)[..., None]


def planks() -> Field:
    """Oak floor boards, 1.6 m of them, along the columns' direction."""
    boards, rng = 12, np.random.default_rng(3)
    down, across = pixel_grid()
    board = (across * boards).astype(int)
    joint = rng.uniform(0, 1, boards)[board]
    tone = rng.uniform(-1, 1, (boards, 2))
    second = ((down - joint) % 1 < 0.5).astype(int)
    shade = tone[np.broadcast_to(board, second.shape), second]
    grain = noise((4, 64), 2, seed=4)
    wood = mix((0.20, 0.105, 0.045), (0.36, 0.21, 0.10), 0.5 + 0.3 * shade + 0.16 * grain)
    edge = np.abs((across * boards + 0.5) % 1 - 0.5) < 0.04
    end = np.abs(((down - joint) * 2 + 0.5) % 1 - 0.5) < 0.008
    wood[edge | end] *= 0.45
    return wood


def masonry(
    courses: int,
    stones: int,
    colours: tuple[Colour, Colour],
    mortar: Colour,
    joint: float,
    seed: int,
    bond: float = 0.5,
) -> Field:
    """Courses of stones with joints between them.

    Parameters
    ----------
    courses, stones
        Rows of stones in a tile and stones in a row.
    colours
        Linear colours between which the stones vary.
    mortar
        Linear colour of the joints.
    joint
        Width of the joints as a fraction of a course's height.
    seed
        Seed of the stones' colours.
    bond
        Shift of every other course, in stones.
    """
    down, across = pixel_grid()
    course = (down * courses).astype(int)
    position = across * stones + bond * (course % 2)
    stone = np.floor(position).astype(int) % stones
    tone = np.random.default_rng(seed).uniform(0, 1, (courses, stones))[course, stone]
    rough = noise((16, 16), 3, seed=seed + 1)
    wall = mix(*colours, np.clip(tone + 0.15 * rough, 0, 1)) * (1 + 0.08 * rough)[..., None]
    beside = np.abs((position + 0.5) % 1 - 0.5) * courses / stones
    above = np.abs((down * courses + 0.5) % 1 - 0.5)
    wall[(beside < joint / 2) | (above < joint / 2)] = mortar
    return wall


def bricks() -> Field:
    """Red bricks in stretcher bond, 1.25 m x 1.25 m."""
    red = ((0.20, 0.055, 0.030), (0.40, 0.155, 0.085))
    return masonry(16, 5, red, (0.38, 0.34, 0.29), joint=0.16, seed=11)


def paving() -> Field:
    """Concrete slabs, 1.6 m x 1.6 m."""
    grey = ((0.22, 0.215, 0.205), (0.30, 0.29, 0.275))
    return masonry(4, 4, grey, (0.07, 0.068, 0.062), joint=0.035, seed=13, bond=0.0)


def ashlar() -> Field:
    """Sandstone blocks of a church, 2 m x 2 m."""
    sand = ((0.33, 0.27, 0.19), (0.46, 0.39, 0.29))
    return masonry(8, 4, sand, (0.26, 0.22, 0.16), joint=0.05, seed=17)


def ceiling_tiles() -> Field:
    """Mineral tiles of a suspended ceiling, 2.4 m x 2.4 m."""
    white = ((0.70, 0.69, 0.67), (0.76, 0.75, 0.73))
    return masonry(4, 4, white, (0.42, 0.42, 0.42), joint=0.035, seed=19, bond=0.0)


def carpet() -> Field:
    """Carpet tiles, 2 m x 2 m, their pile turned from one to the next."""
    down, across = pixel_grid()
    turned = ((down * 4).astype(int) + (across * 4).astype(int)) % 2
    pile = noise((64, 64), 2, seed=23)
    grey = mix((0.055, 0.068, 0.090), (0.078, 0.092, 0.118), 1.0 * turned)
    return grey * (1 + 0.3 * pile)[..., None]


def facade() -> Field:
    """One bay of a plastered house front, 3 m x 3 m: a casement with stone surround and sill."""
    down, across = pixel_grid()
    front = mix((0.50, 0.44, 0.34), (0.56, 0.50, 0.40), 0.5 + 0.3 * noise((4, 4), 4, seed=29))

    def between(top: float, bottom: float, left: float, right: float) -> NDArray[np.bool_]:
        return (down > top) & (down < bottom) & (across > left) & (across < right)

    front[between(0.16, 0.80, 0.29, 0.71)] = (0.62, 0.59, 0.53)
    front[between(0.78, 0.82, 0.26, 0.74)] = (0.66, 0.63, 0.57)
    front[between(0.20, 0.78, 0.33, 0.67)] = (0.70, 0.70, 0.68)
    for left, right in ((0.35, 0.49), (0.51, 0.65)):
        for top, bottom in ((0.22, 0.38), (0.40, 0.76)):
            front[between(top, bottom, left, right)] = (0.035, 0.045, 0.055)
    front[between(0.0, 0.03, 0.0, 1.0)] = (0.58, 0.53, 0.44)
    return front


def curtain() -> Field:
    """Light through a sheer curtain in folds, 1.5 m of it."""
    _, across = pixel_grid()
    swing = across + 0.012 * np.sin(6 * np.pi * across + 1) + 0.008 * np.sin(10 * np.pi * across)
    folds = 0.5 + 0.5 * np.sin(2 * np.pi * 13 * swing)
    weave = noise((128, 128), 1, seed=43)
    return mix((0.10, 0.10, 0.10), (0.24, 0.235, 0.22), folds) * (1 + 0.02 * weave)[..., None]


def overcast() -> Field:
    """Overcast sky as an equirectangular map, zenith in row 0, horizon in the middle row.

    The International Commission on Illumination's overcast sky, three times as bright at the zenith
    as at the horizon, with faint clouds; grey ground below the horizon.
    """
    shape = (128, 256)
    down, _ = pixel_grid(shape)
    sine = np.cos(np.pi * down)
    # Clouds shrink towards the horizon; none at the zenith, where the map is pinched.
    clouds = noise((6, 5), 4, seed=31, shape=shape) * smoothstep(0.0, 0.25, down)
    sky = (1 + 2 * sine) / 3 * (1 + 0.10 * clouds)
    picture = sky[..., None] * (0.93, 0.97, 1.0)
    return np.where((sine > 0)[..., None], picture, (0.10, 0.10, 0.10))


# -- stained glass -----------------------------------------------------------------------------

GLASS_SHAPE = (512, 256)
"""Pixels of the stained-glass window, which is 2 m high and 1 m wide."""
SUN_DISC = 15
"""Pixels of the window across the sun's disc, as seen 6.3 m behind the window."""

JEWELS = np.array(
    [
        (0.75, 0.02, 0.02), (0.02, 0.07, 0.70), (0.90, 0.48, 0.02), (0.02, 0.38, 0.06),
        (0.34, 0.03, 0.42), (0.85, 0.78, 0.55),
    ]
)  # fmt: skip
RED, BLUE, AMBER, GREEN, VIOLET, PEARL = range(6)


def glass_pieces() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Give the number and colour of the glass at each pixel; -1 outside the lancet."""
    down, across = pixel_grid(GLASS_SHAPE)
    x, y = across - 0.5 + 0 * down, 2 * down + 0 * across  # metres; y downwards from the top
    # The lancet's head: two arcs of radius 1 about the opposite springings, 0.85 m below the top.
    head = np.maximum(np.hypot(x - 0.46, y - 0.84), np.hypot(x + 0.46, y - 0.84))
    inset = np.where(y < 0.84, 0.92 - head, 0.46 - np.abs(x))
    inset = np.minimum(inset, 1.96 - y)

    lattice = np.floor((x + y) / 0.22), np.floor((x - y) / 0.22)
    piece = (1000 + 40 * (lattice[0] + 20) + lattice[1] + 20).astype(np.int64)
    colour = np.where((lattice[0] + lattice[1]) % 2 == 0, BLUE, VIOLET)
    for number, (center, fill) in enumerate([(0.55, RED), (1.10, GREEN), (1.62, RED)]):
        radius, angle = np.hypot(x, y - center), np.arctan2(x, y - center)
        petal = np.floor((angle / (2 * np.pi) + 0.5) * 8).astype(np.int64)
        for ring, (reach, colours) in enumerate(
            [(0.25, (AMBER, AMBER)), (0.215, (fill, PEARL)), (0.085, (AMBER, AMBER))]
        ):
            inside = radius < reach
            piece[inside] = (100 * number + 10 * ring + petal * (ring < 2))[inside]
            colour[inside] = np.where(petal % 2 == 0, *colours)[inside]
    border = inset < 0.075
    strip = np.floor(y / 0.16).astype(np.int64)
    piece[border] = (4000 + 2 * strip + (x > 0))[border]
    colour[border] = np.where(strip % 2 == 0, RED, AMBER)[border]
    outside = inset < 0
    piece[outside] = colour[outside] = -1
    return piece, colour


def stained_glass() -> Field:
    """Lancet window of coloured glass between lead cames; black outside it."""
    piece, colour = glass_pieces()
    tone = 1 + 0.25 * noise((24, 12), 2, seed=37, shape=GLASS_SHAPE)
    # Every piece is a little lighter or darker than its neighbours.
    tone *= np.random.default_rng(41).uniform(0.7, 1.2, 8192)[piece]
    picture = JEWELS[colour] * tone[..., None]
    lead = np.zeros(GLASS_SHAPE, bool)
    for axis in (0, 1):
        for shift in (-1, 1, 2):
            lead |= piece != np.roll(piece, shift, axis)
    picture[lead | (piece < 0)] = 0
    return picture


def stained_sunlight() -> Field:
    """Sunlight behind the window: its picture blurred by the disc of the sun."""
    from scipy import ndimage

    across = np.arange(SUN_DISC) - SUN_DISC // 2
    disc = (across[:, None] ** 2 + across**2 <= (SUN_DISC / 2) ** 2).astype(float)
    weights = disc[..., None] / disc.sum()
    blurred: Field = ndimage.convolve(stained_glass(), weights, mode="constant")
    return blurred


TEXTURES: dict[str, Callable[[], Field]] = {
    "ashlar": ashlar,
    "bricks": bricks,
    "carpet": carpet,
    "ceiling_tiles": ceiling_tiles,
    "curtain": curtain,
    "facade": facade,
    "grass": grass,
    "overcast": overcast,
    "paving": paving,
    "planks": planks,
    "stained_glass": stained_glass,
    "stained_sunlight": stained_sunlight,
}


def encode(picture: Field) -> NDArray[np.uint8]:
    """Encode linear light as sRGB (IEC 61966-2-1)."""
    linear = np.clip(picture, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    codes: NDArray[np.uint8] = np.round(255 * encoded).astype(np.uint8)
    return codes


def main() -> None:
    """Write every texture as a PNG file."""
    from PIL import Image

    TEXTURE_FOLDER.mkdir(parents=True, exist_ok=True)
    for name, draw in TEXTURES.items():
        path = TEXTURE_FOLDER / f"{name}.png"
        Image.fromarray(encode(draw())).save(path, optimize=True)
        print(path)


if __name__ == "__main__":
    main()
