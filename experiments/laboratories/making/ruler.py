"""What a person measures: the scene file's numbers, with a ruler's errors."""

import re

import numpy as np

ERROR = "_error"
LARGEST = 2.0
"""Standard deviations."""
_DEFAULT = re.compile(r'<default name="(?P<name>\w+)" value="(?P<value>[^"]*)"/>')


def declared(text: str) -> dict[str, float]:
    """Return the numbers that a scene file declares, by name."""
    return {found["name"]: float(found["value"]) for found in _DEFAULT.finditer(text)}


def read_by_ruler(text: str, seed: int) -> dict[str, float]:
    """Return what a ruler reads where the truth is a scene file's: Gaussian errors as declared.

    None is beyond `LARGEST` standard deviations: a person measures such a number again. Readings
    are rounded as a person rounds: lengths to the millimetre, angles to half a degree.
    """
    values = declared(text)
    rng = np.random.default_rng([seed, 20])
    read = {}
    for name in sorted(values):
        if (error := values.get(name + ERROR)) is not None:
            step = 0.5 if name.endswith("turn") else 0.001
            while abs(deviation := rng.standard_normal()) > LARGEST:
                pass
            value = values[name] + error * deviation
            read[name] = round(round(value / step) * step, 6)
    return read
