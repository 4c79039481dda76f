"""The page that shows a laboratory: handles in its scene, what is chosen beside it.

All who look at it see and set the same. Nothing is computed here.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from threading import RLock
from typing import Any

import numpy as np

from periscopy_sim.extras import require
from periscopy_sim.live.choice import Choice
from periscopy_sim.live.level import LivePictures
from periscopy_sim.live.movable import Handle, Movable
from periscopy_sim.live.room import Room
from periscopy_sim.live.sheet import draw_sheet
from periscopy_sim.scenario import Scenario

SLIDING = 0.3
"""Seconds after which a slider that was moved counts as at rest: it does not tell when it is let go
of."""

DRAGGING = 1.0
"""The same of a handle, which does tell when it is let go of."""

SBRS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
SNRS = 20, 80
NOTHING, UNKNOWN = "none", "not known"
WIDTH = 470
"""Of what stands beside the scene, in pixels."""

GIZMO = 0.14
"""Length of a handle's arrows, in metres."""

Want = Callable[[Choice, float], None]


@dataclass(frozen=True)
class Offered:
    """What can be chosen: hidden images, ambient places, methods."""

    images: Sequence[str]
    places: Sequence[str]
    methods: Sequence[str]


class Page:
    """A page on a port of this computer, at first without pictures; see `show`.

    What is set is given to `want`, with the seconds after which it counts as at rest; `save` is
    called by a button; `server` is viser's. A PeriscopyError says that the extra is not installed,
    or the port is taken.
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
    ) -> None:
        viser = require("viser")
        from periscopy_sim.live import gate

        self.gate = gate.Gate(host, port)
        self._choices, self._interval = gate.choices, gate.interval
        self._choice, self._movables = first, {each.name: each for each in movables}
        self._lock = RLock()
        self._dragged: Handle | None = None
        self.want: Want = lambda *_: None
        self.save: Callable[[], None] = lambda: None
        with _silence(), self.gate.guarding():
            self.server = viser.ViserServer(host=host, port=port, label="periscopy", verbose=False)
        self._gui = self.server.gui
        self._room = Room(self.server, scenario)
        self._handles = {each.name: (each, self._add_handle(each)) for each in handles}
        self.gate.offer("handle", self._choices([f"/handles/{each.name}" for each in handles]))
        self._sliders: dict[str, Any] = {}
        self._lay_out(offered, first, is_given)
        self.server.on_client_disconnect(lambda _: self._let_go())

    @property
    def url(self) -> str:
        """The address of the page, which lets its reader in."""
        return self.gate.url

    def handle(self, name: str) -> Handle:
        """Return one of its handles."""
        return self._handles[name][0]

    @property
    def choice(self) -> Choice:
        """What is set now."""
        with self._lock:
            return self._choice

    def show(self, pictures: LivePictures) -> None:
        """Show pictures, and what they are of, but for what is being dragged."""
        sheet = draw_sheet(pictures)
        with self.server.atomic():
            self._room.show(pictures)
            self._sheet.image = sheet
            with self._lock:
                for name, slider in self._sliders.items():
                    value = self._choice.values[name]
                    if abs(slider.value - value) > self._movables[name].step / 2:
                        slider.value = value
                for handle, gizmo in self._handles.values():
                    if handle is not self._dragged:
                        gizmo.position = tuple(handle.position(self._choice.values))
        self.server.flush()
        notes = [each for each in (pictures.doubt, pictures.remark) if each]
        self._note.content = "  \n".join(notes)
        size = "coarse" if pictures.is_coarse else "full"
        self._pace.content = f"{size} pictures in {pictures.seconds:.2g} s"

    def tell(self, text: str) -> None:
        """Show why there are no pictures of what is set; empty where there are."""
        self._trouble.content = f"**{text}**" if text else ""

    def close(self) -> None:
        """End the page for all who look at it."""
        with _silence():
            self.server.stop()

    # -- what stands beside the scene --------------------------------------------------------------

    def _lay_out(self, offered: Offered, first: Choice, is_given: bool) -> None:
        gui = self._gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH)
        self._sheet = gui.add_image(
            np.full((8, 8, 3), 255, np.uint8), format="jpeg", jpeg_quality=90
        )
        self._trouble = gui.add_markdown("computing the first pictures")
        self._choose("Method", offered.methods, first.method, lambda name: {"method": name})
        if is_given:
            images = [UNKNOWN, *offered.images]
            self._choose(
                "Hidden image", images, first.image or UNKNOWN,
                lambda name: {"image": "" if name == UNKNOWN else name},
            )  # fmt: skip
        else:
            self._choose("Hidden image", offered.images, first.image, lambda n: {"image": n})
            places = self._choose(
                "Ambient light", [NOTHING, *offered.places], first.place or NOTHING,
                lambda name: {"place": "" if name == NOTHING else name},
            )  # fmt: skip
            ratios = [f"{sbr:g}" for sbr in sorted({*SBRS, first.sbr})]
            sbr = self._choose("SBR", ratios, f"{first.sbr:g}", lambda text: {"sbr": float(text)})

            def allow_sbr(_: object = None) -> None:
                sbr.disabled = places.value == NOTHING

            places.on_update(allow_sbr)
            allow_sbr()
            low, high = min(SNRS[0], first.snr), max(SNRS[1], first.snr)
            snr = gui.add_slider("SNR (dB)", low, high, 1.0, first.snr)
            self._offer(snr, self._interval(low, high))
            snr.on_update(lambda event: self._change(SLIDING, snr=float(event.target.value)))
            hold = gui.add_checkbox(
                "Keep the photograph", initial_value=False,
                hint="The photograph stays as it was taken; only what the method believes moves.",
            )  # fmt: skip
            self._offer(hold, bool)
            hold.on_update(lambda event: self._hold(bool(event.target.value)))
        with_handles = {name for handle, _ in self._handles.values() for name in handle.names}
        groups = grouped(self._movables, with_handles)
        for title, names, is_open in groups:
            with gui.add_folder(title, expand_by_default=is_open):
                for name in names:
                    label = name.removeprefix(f"{title}_")
                    self._sliders[name] = self._add_slider(self._movables[name], label)
        back = gui.add_button("Back to the file's values")
        self._offer(back, bool)
        back.on_click(lambda _: self._set({n: m.value for n, m in self._movables.items()}, 0.0))
        write = gui.add_button("Write scene and pictures", color="green")
        self._offer(write, bool)
        write.on_click(lambda _: self.save())
        self._note = gui.add_markdown("")
        self._pace = gui.add_markdown("")

    def _choose(
        self,
        label: str,
        options: Iterable[str],
        first: str,
        change: Callable[[str], Mapping[str, Any]],
    ) -> Any:
        names = list(dict.fromkeys([*options, first]))
        box = self._gui.add_dropdown(label, names, initial_value=first)
        self._offer(box, self._choices(names))
        box.on_update(lambda event: self._change(0.0, **change(event.target.value)))
        return box

    def _offer(self, control: Any, values: Any) -> None:
        self.gate.offer(control._impl.uuid, values)

    def _add_slider(self, movable: Movable, label: str) -> Any:
        slider = self._gui.add_slider(
            label, movable.low, movable.high, movable.step, movable.value, hint=movable.name
        )
        self._offer(slider, self._interval(movable.low, movable.high))

        def slid(event: Any) -> None:
            value = float(event.target.value)
            with self._lock:
                if abs(value - self._choice.values[movable.name]) > movable.step / 2:
                    self._set({movable.name: value}, SLIDING)

        slider.on_update(slid)
        return slider

    def _add_handle(self, handle: Handle) -> Any:
        x, y, z = handle.axes
        gizmo = self.server.scene.add_transform_controls(
            f"/handles/{handle.name}", scale=GIZMO, active_axes=(x, y, z), disable_rotations=True,
            depth_test=False, position=tuple(handle.center),
        )  # fmt: skip

        self.server.scene.add_label(
            f"/handles/{handle.name}/label", handle.name, position=(0.0, 0.0, 1.3 * GIZMO),
            anchor="bottom-center",
        )  # fmt: skip

        async def dragged(event: Any) -> None:
            self._drag(handle, np.asarray(event.target.position, np.float64), event.phase)

        gizmo.on_update(dragged)
        return gizmo

    # -- what is set -------------------------------------------------------------------------------

    def _drag(self, handle: Handle, position: Any, phase: str) -> None:
        with self._lock:
            self._dragged = None if phase == "end" else handle
            self._set(handle.values(position), 0.0 if phase == "end" else DRAGGING)

    def _let_go(self) -> None:
        """Let go of what may have been dragged on a page that was closed."""
        with self._lock:
            if self._dragged is not None:
                self._dragged = None
                self.want(self._choice, 0.0)

    def _set(self, values: Mapping[str, float], rest: float) -> None:
        with self._lock:
            within = {name: self._movables[name].within(value) for name, value in values.items()}
            self._change(rest, values={**self._choice.values, **within})

    def _hold(self, is_held: bool) -> None:
        with self._lock:
            self._change(0.0, taken=dict(self._choice.values) if is_held else None)

    def _change(self, rest: float, **changes: Any) -> None:
        with self._lock:
            self._choice = replace(self._choice, **changes)
            self.want(self._choice, rest)


def _silence() -> contextlib.redirect_stdout[io.StringIO]:
    """Keep the server from printing what the command says in a line."""
    return contextlib.redirect_stdout(io.StringIO())


def grouped(
    movables: Mapping[str, Movable], with_handles: Iterable[str]
) -> list[tuple[str, list[str], bool]]:
    """Return the titles of the groups of movables, their names, and whether each is open at first.

    What begins alike belongs together; those without a handle come last, together.
    """
    leading = {name.split("_")[0] for name in with_handles}
    groups: dict[str, list[str]] = {}
    for name in movables:
        first = name.split("_")[0]
        groups.setdefault(first if first in leading else "", []).append(name)
    others = groups.pop("", [])
    shown = [(title, names, True) for title, names in groups.items()]
    return [*shown, *([("other parameters", others, not shown)] if others else [])]
