"""The page that shows a laboratory: handles in its scene, controls beside it.

All viewers see and set the same. The page computes nothing.
"""

import contextlib
import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from threading import RLock
from typing import Any

import numpy as np

from periscopy_sim.extras import require
from periscopy_sim.live.level import Choice, LivePictures
from periscopy_sim.live.movable import Handle, Movable
from periscopy_sim.live.room import Room
from periscopy_sim.live.sheet import draw_sheet
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.scenario import Scenario

REST = {"slider": 0.3, "handle": 1.0}
"""Seconds after which a control counts as at rest; only a handle reports its release."""

GIZMO = 0.14
"""Length of a handle's arrows, in metres."""

LOOK = (
    "display: grid; gap: 0.2em 1em; margin: 0 0.9em 0.6em; font-size: 14px; overflow-wrap: anywhere"
)
"""The style of text on the page: the size of its labels, and their distance from the edge."""


@dataclass(frozen=True)
class Offered:
    """The hidden images, methods and SBRs among which a viewer can choose.

    No images: the photograph is given, and only its method can be chosen.
    """

    images: Sequence[str]
    methods: Sequence[str]
    sbrs: Sequence[float] = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


class Page:
    """A page on a port of this computer, at first without pictures; see `show`.

    It calls `want` with each new choice and the seconds after which that counts as at rest, and
    `save` when its button is pressed. `describe` returns a report's sentences. `server` is viser's,
    behind `gate`. A PeriscopyError says that the extra is not installed, or the port is taken.
    """

    def __init__(
        self,
        host: str,
        port: int,
        scenario: Scenario,
        movables: Sequence[Movable],
        handles: Sequence[Handle],
        offered: Offered,
        first: Choice,
        describe: Callable[[Report], Sequence[str]],
    ) -> None:
        viser = require("viser")
        from periscopy_sim.live.gate import Gate

        self._describe = describe
        self.choice, self._movables = first, {each.name: each for each in movables}
        self._lock = RLock()
        self._dragged: Handle | None = None
        self.want: Callable[[Choice, float], None] = lambda *_: None
        self.save: Callable[[], None] = lambda: None
        self.gate = Gate(host, port)
        with contextlib.redirect_stdout(None), self.gate.guarding():
            self.server = viser.ViserServer(host=host, port=port, label="periscopy", verbose=False)
        self._room = Room(self.server, scenario)
        self.handles = {each.name: each for each in handles}
        self._gizmos = {each.name: self._add_handle(each) for each in handles}
        self.gate.offer_names("handle", [f"/handles/{name}" for name in self.handles])
        self._sliders: dict[str, Any] = {}
        self._lay_out(offered, first)

    def show(self, pictures: LivePictures) -> None:
        """Show pictures and their values, but for the handle that is being dragged."""
        sheet, captions = draw_sheet(pictures)
        with self.server.atomic(), self._lock:
            self._room.show(pictures)
            self._sheet.image = sheet
            _write(self._captions, captions, "grid-template-columns: 1fr 1fr")
            for name, slider in self._sliders.items():
                if self._differs(name, slider.value):
                    slider.value = self.choice.values[name]
            for name, handle in self.handles.items():
                if handle is not self._dragged:
                    self._gizmos[name].position = tuple(handle.position(self.choice.values))
        self.server.flush()
        size = "coarse" if pictures.is_coarse else "full"
        notes = *self._describe(pictures.report), f"{size} pictures in {pictures.seconds:.2g} s"
        _write(self._notes, notes)

    def tell(self, text: str) -> None:
        """Show why there are no pictures of the present choice; empty where there are."""
        _write(self._trouble, [text] if text else [], "font-weight: bold")

    def close(self) -> None:
        """End the page for all viewers."""
        with contextlib.redirect_stdout(None):  # it would print a line
            self.server.stop()

    # -- controls ----------------------------------------------------------------------------------

    def _lay_out(self, offered: Offered, first: Choice) -> None:
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(470)
        blank = np.full((8, 8, 3), 255, np.uint8)
        self._sheet = gui.add_image(blank, format="jpeg", jpeg_quality=90)
        self._captions, self._trouble = gui.add_html(""), gui.add_html("")
        _write(self._trouble, ["computing the first pictures"])
        self._choose("Method", "method", {name: name for name in (*offered.methods, first.method)})
        if offered.images:
            self._choose("Hidden image", "image", {n: n for n in (*offered.images, first.image)})
            noise = Movable("SNR (dB)", first.snr, 20.0, 80.0, 1.0)
            self._slide(noise, lambda snr: self._change(REST["slider"], snr=snr))
        if first.place:
            self._choose("Ambient light", "place", {first.place: first.place, "none": ""})
            self._choose("SBR", "sbr", {str(sbr): sbr for sbr in offered.sbrs})
        placing = {name for handle in self.handles.values() for name in handle.names}
        others = self._movables.keys() - placing
        for title, names in ("places", placing), ("other parameters", others):
            if names:
                with gui.add_folder(title, expand_by_default=names is placing or not placing):
                    for name in filter(names.__contains__, self._movables):
                        act = partial(self._follow_slider, name)
                        self._sliders[name] = self._slide(self._movables[name], act)
        self._press("Back to the file's values", lambda: self._set(first.values, 0.0))
        self._press("Write scene and pictures", lambda: self.save())
        self._notes = gui.add_html("")

    def _choose(self, label: str, field: str, options: Mapping[str, Any]) -> None:
        first = next(name for name, each in options.items() if each == getattr(self.choice, field))
        box = self.server.gui.add_dropdown(label, list(options), initial_value=first)
        self.gate.offer_names(box._impl.uuid, list(options))
        box.on_update(lambda event: self._change(0.0, **{field: options[event.target.value]}))

    def _slide(self, number: Movable, act: Callable[[float], None]) -> Any:
        ends = number.low, number.high
        slider = self.server.gui.add_slider(number.name, *ends, number.step, number.value)
        self.gate.offer_values(slider._impl.uuid, ends)
        slider.on_update(lambda event: act(float(event.target.value)))
        return slider

    def _press(self, label: str, act: Callable[[], None]) -> None:
        button = self.server.gui.add_button(label)
        self.gate.offer_values(button._impl.uuid)
        button.on_click(lambda _: act())

    def _add_handle(self, handle: Handle) -> Any:
        path = f"/handles/{handle.name}"
        gizmo = self.server.scene.add_transform_controls(
            path, scale=GIZMO, active_axes=handle.axes, disable_rotations=True, depth_test=False,
            position=tuple(handle.center),
        )  # fmt: skip
        self.server.scene.add_label(
            f"{path}/label", handle.name, position=(0, 0, 1.3 * GIZMO), anchor="bottom-center"
        )

        async def drag(event: Any) -> None:
            has_ended = event.phase == "end"
            self._dragged = None if has_ended else handle
            position = np.asarray(event.target.position, np.float64)
            self._set(handle.values(position), 0.0 if has_ended else REST["handle"])

        gizmo.on_update(drag)
        return gizmo

    # -- choices -----------------------------------------------------------------------------------

    def _differs(self, name: str, value: float) -> bool:
        return abs(value - self.choice.values[name]) > self._movables[name].step / 2

    def _follow_slider(self, name: str, value: float) -> None:
        if self._differs(name, value):  # a slider also follows a handle
            self._set({name: value}, REST["slider"])

    def _set(self, values: Mapping[str, float], rest: float) -> None:
        with self._lock:
            within = dict(self.choice.values)
            for name, value in values.items():
                within[name] = min(max(value, self._movables[name].low), self._movables[name].high)
            self._change(rest, values=within)

    def _change(self, rest: float, **changes: Any) -> None:
        with self._lock:
            self.choice = replace(self.choice, **changes)
            self.want(self.choice, rest)


def _write(place: Any, lines: Sequence[str], style: str = "") -> None:
    """Show lines on the page; none of their characters is markup, wherever they come from.

    All text but that of labels and options, which viser never takes for markup, enters here.
    """
    cells = "".join(f"<div>{html.escape(line)}</div>" for line in lines)
    place.content = f'<div style="{LOOK}; {style}">{cells}</div>' if cells else ""
