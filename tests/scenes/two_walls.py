"""Two walls at a right angle, a camera before each, one hidden monitor, a post before either."""

from pathlib import Path

_SENSOR = """<sensor type="orthographic" id="{0}"><transform name="to_world">
<scale x="0.2" y="0.2"/><lookat origin="{1}, 0.3" target="{2}, 0.3" up="0, 0, 1"/>
<translate x="${0}_dx"/></transform><film type="hdrfilm"><integer name="width" value="{3}"/>
<integer name="height" value="{4}"/><rfilter type="box"/></film></sensor>"""
_WALL = """<shape type="rectangle" id="{0}"><transform name="to_world"><scale value="0.6"/>
<rotate x="1" angle="90"/><rotate z="1" angle="{1}"/><translate value="{2}, 0.3"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="{3}"/></bsdf></shape>"""
_POST = """<shape type="cube" id="{0}"><transform name="to_world"><scale value="0.02, 0.02, 0.15"/>
<translate value="{1}, 0.2"/></transform></shape>"""
_MONITOR = """<shape type="rectangle" id="monitor"><transform name="to_world">
<scale x="0.2" y="0.15"/><rotate x="1" angle="90"/><rotate z="1" angle="180"/>
<translate value="0, 0, 0.3"/></transform>
<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>"""
_DEFAULTS = '<default name="left_dx" value="0"/><default name="right_dx" value="0"/>'

CAMERAS = "left", "right"
SHAPES = {"left": (24, 24), "right": (20, 26)}


def write_two_walls(folder: Path, reflectance: str = "0.8") -> Path:
    """Write the scene: `left` sees `wall_back`, `right` sees `wall`, of this reflectance."""
    parts = (
        _DEFAULTS,
        _SENSOR.format("left", "0.3, 0.95", "0.3, 1", *SHAPES["left"][::-1]),
        _SENSOR.format("right", "0.85, 0.6", "0.9, 0.6", *SHAPES["right"][::-1]),
        _WALL.format("wall_back", 0, "0.3, 1", "0.8"),
        _WALL.format("wall", -90, "0.9, 0.4", reflectance),
        _POST.format("far", "0.17, 0.62"),
        _POST.format("near", "0.52, 0.32"),
        _MONITOR,
    )
    path = folder / "two_walls.xml"
    path.write_text('<scene version="3.0.0">\n' + "\n".join(parts) + "\n</scene>\n")
    return path
