"""Camera raw files as DNG, which LibRaw reads as it reads a camera's."""

import struct

import tifffile

WHITE = 16383
CFA = 32803
RGGB = (0, 1, 1, 2)
IDENTITY = 10000, 0, 0, 0, 10000, 0, 0, 0, 10000


def write_dng(
    path, mosaic, black=(512,), pattern=RGGB, turn=1, photometric=CFA, colours=IDENTITY,
    opcodes=(),
):  # fmt: skip
    """A DNG of version 1.4: the tags that its specification asks for, and no more."""
    matrix = tuple(number for entry in colours for number in (entry, 10000))
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50708, "s", 0, "Test Camera", True),  # UniqueCameraModel
        (274, "H", 1, turn, True),  # Orientation
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, pattern, True),  # CFAPattern
        (50714, "H", len(black), black if len(black) > 1 else black[0], True),  # BlackLevel
        (50717, "H", 1, WHITE, True),  # WhiteLevel
        (50721, "2i", 9, matrix, True),  # ColorMatrix1
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1
    ]
    if photometric != CFA:
        tags = [tag for tag in tags if tag[0] not in (33421, 33422)]
    if len(black) > 1:
        tags.append((50713, "H", 2, (2, 2), True))  # BlackLevelRepeatDim
    for tag, numbers in opcodes:
        content = struct.pack(">I", len(numbers))
        content += b"".join(struct.pack(">4I", n, 0x01030000, 0, 4) + bytes(4) for n in numbers)
        tags.append((tag, 7, len(content), content, True))
    tifffile.imwrite(path, mosaic, photometric=photometric, extratags=tags, metadata=None)
    return path
