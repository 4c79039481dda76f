"""The page that shows a laboratory: handles in its scene, controls beside it.

All viewers see and set the same. The page computes nothing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from threading import RLock
from typing import Any

import numpy as np

from periscopy_sim.extras import require
from periscopy_sim.live.choice import Choice
from periscopy_sim.live.level import LivePictures
from periscopy_sim.live.movable import Handle, Movable
from periscopy_sim.live.room import Room
from periscopy_sim.live.sheet import draw_sheet
from periscopy_sim.reconstruction.report import Report
from periscopy_sim.scenario import Scenario

REST = {"slider": 0.3, "handle": 1.0}
"""Seconds after which a control counts as at rest; only a handle reports its release."""

SBRS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)

GIZMO = 0.14
"""Length of a handle's arrows, in metres."""


@dataclass(frozen=True)
class Offered:
    """The hidden images, ambient places and methods among which a viewer can choose."""

    images: Sequence[str]
    places: Sequence[str]
    methods: Sequence[str]


class Page:
    """A page on a port of this computer, at first without pictures; see `show`.

    It calls `want` with each new choice and the seconds after which that counts as at rest, and
    `save` when its button is pressed. `describe` returns a report's sentences. With a photograph
    (`is_given`) it offers methods alone. `server` is viser's, behind `gate`. A PeriscopyError says
    that the extra is not installed, or the port is taken.
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
        *,
        is_given: bool,
        describe: Callable[[Report], Sequence[str]],
    ) -> None:
        viser = require("viser")
        from periscopy_sim.live.gate import Gate

        self._describe = describe
        self._choice, self._movables = first, {each.name: each for each in movables}
        self._lock = RLock()
        self._dragged: Handle | None = None
        self.want: Callable[[Choice, float], None] = lambda *_: None
        self.save: Callable[[], None] = lambda: None
        self.gate = Gate(host, port)
        with contextlib.redirect_stdout(None), self.gate.guarding():
            self.server = viser.ViserServer(host=host, port=port, label="periscopy", verbose=False)
        self._room = Room(self.server, scenario)
        self._handles = {each.name: (each, self._add_handle(each)) for each in handles}
        self.gate.offer_names("handle", [f"/handles/{name}" for name in self._handles])
        self._sliders: dict[str, Any] = {}
        self._lay_out(offered, first, is_given)

    def handle(self, name: str) -> Handle:
        """Return one of its handles."""
        return self._handles[name][0]

    @property
    def choice(self) -> Choice:
        """The present choice."""
        return self._choice

    def show(self, pictures: LivePictures) -> None:
        """Show pictures and their values, but for the handle that is being dragged."""
        sheet, captions = draw_sheet(pictures)
        with self.server.atomic(), self._lock:
            self._room.show(pictures)
            self._sheet.image, self._captions.content = sheet, captions
            for name, slider in self._sliders.items():
                if self._differs(name, slider.value):
                    slider.value = self._choice.values[name]
            for handle, gizmo in self._handles.values():
                if handle is not self._dragged:
                    gizmo.position = tuple(handle.position(self._choice.values))
        self.server.flush()
        size = "coarse" if pictures.is_coarse else "full"
        notes = *self._describe(pictures.report), f"{size} pictures in {pictures.seconds:.2g} s"
        self._notes.content = "  \n".join(notes)

    def tell(self, text: str) -> None:
        """Show why there are no pictures of the present choice; empty where there are."""
        self._trouble.content = f"**{text}**" if text else ""

    def close(self) -> None:
        """End the page for all viewers."""
        with contextlib.redirect_stdout(None):  # it would print a line
            self.server.stop()

    # -- controls ----------------------------------------------------------------------------------

    def _lay_out(self, offered: Offered, first: Choice, is_given: bool) -> None:
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(470)
        blank = np.full((8, 8, 3), 255, np.uint8)
        self._sheet = gui.add_image(blank, format="jpeg", jpeg_quality=90)
        self._captions = gui.add_markdown("")
        self._trouble = gui.add_markdown("computing the first pictures")
        self._choose("Method", "method", _names(offered.methods, first.method))
        if not is_given:
            self._choose("Hidden image", "image", _names(offered.images, first.image))
            places = {"none": ""} | _names(offered.places, first.place)
            self._choose("Ambient light", "place", places)
            self._choose("SBR", "sbr", {str(sbr): sbr for sbr in sorted({*SBRS, first.sbr})})
            noise = Movable("SNR (dB)", first.snr, min(20.0, first.snr), max(80.0, first.snr), 1.0)
            self._slide(noise, lambda snr: self._change(REST["slider"], snr=snr))
        placing = {name for handle, _ in self._handles.values() for name in handle.names}
        others = self._movables.keys() - placing
        for title, names in ("places", placing), ("other parameters", others):
            if names:
                with gui.add_folder(title, expand_by_default=names is placing or not placing):
                    for name in filter(names.__contains__, self._movables):
                        act = partial(self._follow_slider, name)
                        self._sliders[name] = self._slide(self._movables[name], act)
        start = {name: each.value for name, each in self._movables.items()}
        self._press("Back to the file's values", lambda: self._set(start, 0.0))
        self._press("Write scene and pictures", lambda: self.save())
        self._notes = gui.add_markdown("")

    def _choose(self, label: str, field: str, options: Mapping[str, Any]) -> None:
        first = next(name for name, each in options.items() if each == getattr(self._choice, field))
        box = self.server.gui.add_dropdown(label, list(options), initial_value=first)
        self.gate.offer_names(box._impl.uuid, list(options))
        box.on_update(lambda event: self._change(0.0, **{field: options[event.target.value]}))

    def _slide(self, number: Movable, act: Callable[[float], None]) -> Any:
        ends = number.low, number.high
        slider = self.server.gui.add_slider(number.name, *ends, number.step, number.value)
        self.gate.offer_range(slider._impl.uuid, *ends)
        slider.on_update(lambda event: act(float(event.target.value)))
        return slider

    def _press(self, label: str, act: Callable[[], None]) -> None:
        button = self.server.gui.add_button(label)
        self.gate.offer_switch(button._impl.uuid)
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
            self._drag(handle, np.asarray(event.target.position, np.float64), event.phase)

        gizmo.on_update(drag)
        return gizmo

    # -- choices -----------------------------------------------------------------------------------

    def _differs(self, name: str, value: float) -> bool:
        return abs(value - self._choice.values[name]) > self._movables[name].step / 2

    def _follow_slider(self, name: str, value: float) -> None:
        if self._differs(name, value):  # a slider also follows a handle
            self._set({name: value}, REST["slider"])

    def _drag(self, handle: Handle, position: Any, phase: str) -> None:
        self._dragged = None if phase == "end" else handle
        self._set(handle.values(position), 0.0 if phase == "end" else REST["handle"])

    def _set(self, values: Mapping[str, float], rest: float) -> None:
        with self._lock:
            within = {name: self._movables[name].within(value) for name, value in values.items()}
            self._change(rest, values={**self._choice.values, **within})

    def _change(self, rest: float, **changes: Any) -> None:
        with self._lock:
            self._choice = replace(self._choice, **changes)
            self.want(self._choice, rest)


def _names(offered: Sequence[str], first: str) -> dict[str, str]:
    return {name: name for name in (*offered, first) if name}
