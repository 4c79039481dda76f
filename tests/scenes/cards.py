"""The plate's monitor, and before a part of it a card that reflects: two hidden surfaces."""

from pathlib import Path

import periscopy_sim as ps

SIZES = {"monitor": (3, 4), "hidden_card": (3, 2)}
HIDDEN = ("--hidden", "monitor=3x4", "--hidden", "hidden_card=3x2")

CARD = """<shape type="rectangle" id="hidden_card"><transform name="to_world">
<scale x="0.06" y="0.08"/><rotate x="1" angle="90"/><rotate z="1" angle="180"/>
<translate x="0.35" y="0.12" z="0.29"/></transform></shape>"""


def write_cards(folder: Path) -> Path:
    """Write the scene, of 24 x 24 pixels; no number is declared uncertain."""
    text = ps.find_scene("plate").read_text()
    lines = [line for line in text.splitlines() if "_error" not in line]
    scene = "\n".join(lines).replace('value="126"', 'value="24"')
    path = folder / "cards.xml"
    path.write_text(scene.replace("</scene>", f"{CARD}\n</scene>"))
    return path
