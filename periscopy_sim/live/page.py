"""The page that shows a laboratory: handles in its scene, controls beside it.

All viewers see and set the same. The page computes nothing: `page.js` draws what `Gate.publish`
sends, and sends what a person sets.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from threading import RLock
from typing import Any

import numpy as np

from periscopy_sim.extras import require
from periscopy_sim.live.movable import Handle, Movable
from periscopy_sim.live.pictures import Choice, LivePictures
from periscopy_sim.live.room import as_source, room_of, things_in
from periscopy_sim.live.sheet import draw_sheet
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.scenario import Scenario

REST = {"slider": 0.3, "handle": 1.0}
"""Seconds after which a control counts as at rest; only a handle reports its release."""

SBRS = 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0
"""The signal-to-background ratios of the page's list."""


@dataclass(frozen=True)
class Control:
    """A control of the page: how it looks, which values it offers, and what setting one does.

    `look` is what `page.js` draws; `value` returns the present value of the choice.
    """

    look: Mapping[str, Any]
    offers: Callable[[Any], bool]
    act: Callable[[Any], None]
    value: Callable[[], Any] = lambda: None


class Page:
    """A page on a port of this computer, at first without pictures; see `show`.

    A viewer chooses among `images` and `methods`; no images: the photograph is given. The page
    calls `want` with each new choice and the seconds after which that counts as at rest, and
    `save` when its button is pressed. `describe` returns a report's sentences. `gate` serves the
    page. A PeriscopyError says that the extra is not installed, or the port is taken.
    """

    def __init__(
        self,
        host: str,
        port: int,
        scenario: Scenario,
        movables: Sequence[Movable],
        handles: Sequence[Handle],
        images: Sequence[str],
        methods: Sequence[str],
        first: Choice,
        describe: Callable[[Report], Sequence[str]],
    ) -> None:
        require("websockets")
        from periscopy_sim.live.gate import Gate

        self._describe = describe
        self.choice, self._movables = first, {each.name: each for each in movables}
        self._lock = RLock()
        self._dragged: Handle | None = None
        self.want: Callable[[Choice, float], None] = lambda *_: None
        self.save: Callable[[], None] = lambda: None
        self.handles = {each.name: each for each in handles}
        self.controls = self._controls(images, methods, first)
        self.gate = Gate(host, port, self._receive, self._release)
        self.gate.publish(
            room=room_of(scenario), trouble=["computing the first pictures"],
            controls=[{"id": name, **each.look} for name, each in self.controls.items()],
        )  # fmt: skip
        self._publish_choice()

    def show(self, pictures: LivePictures) -> None:
        """Show pictures, their captions and what they tell."""
        sheet, captions = draw_sheet(pictures)
        size = "coarse" if pictures.is_coarse else "full"
        notes = *self._describe(pictures.report), f"{size} pictures in {pictures.seconds:.2g} s"
        self.gate.publish(
            sheet=as_source(sheet, "JPEG", quality=90), captions=captions, notes=notes,
            **things_in(pictures),
        )  # fmt: skip

    def tell(self, text: str) -> None:
        """Show why there are no pictures of the present choice; empty where there are."""
        self.gate.publish(trouble=[text] if text else [])

    def close(self) -> None:
        """End the page for all viewers."""
        self.gate.close()

    # -- controls ----------------------------------------------------------------------------------

    def _controls(
        self, images: Sequence[str], methods: Sequence[str], first: Choice
    ) -> dict[str, Control]:
        """Return the page's controls, by the names in its messages, from top to bottom."""

        def chosen(label: str, field: str, options: Mapping[str, Any]) -> Control:
            names = {each: name for name, each in options.items()}
            return Control(
                {"kind": "choice", "label": label, "options": list(options)},
                lambda value: isinstance(value, str) and value in options,
                lambda value: self._change(0.0, **{field: options[value]}),
                lambda: names[getattr(self.choice, field)],
            )

        def slid(number: Movable, group: str, act: Any, value: Callable[[], float]) -> Control:
            return Control(
                {"kind": "slider", "group": group, "label": number.name}
                | {"low": number.low, "high": number.high, "step": number.step},
                lambda value: _is_number(value) and number.low <= value <= number.high,
                lambda value: act(float(value)),
                value,
            )

        def placed(number: Movable, group: str) -> Control:
            name = number.name
            set_value = lambda value: self._set({name: value}, REST["slider"])  # noqa: E731
            return slid(number, group, set_value, lambda: self.choice.values[name])

        def pressed(label: str, act: Callable[[], None]) -> Control:
            look = {"kind": "button", "label": label}
            return Control(look, lambda value: value is True, lambda _: act())

        def itself(*names: str) -> dict[str, str]:
            return {name: name for name in names}

        controls = {"method": chosen("Method", "method", itself(*methods, first.method))}
        if images:
            offered = itself(*images, first.image)
            controls["image"] = chosen("Hidden image", "image", offered)
            controls["snr"] = slid(
                Movable("SNR (dB)", first.snr, 20.0, 80.0, 1.0), "",
                lambda snr: self._change(REST["slider"], snr=snr), lambda: self.choice.snr,
            )  # fmt: skip
        if first.place:
            offered = itself(first.place) | {"none": ""}
            controls["place"] = chosen("Ambient light", "place", offered)
            controls["sbr"] = chosen("SBR", "sbr", {str(sbr): sbr for sbr in SBRS})
        placing = {name for handle in self.handles.values() for name in handle.names}
        others = self._movables.keys() - placing
        for group, names in ("places", placing), ("other parameters", others):
            for name in filter(names.__contains__, self._movables):
                controls[f"value {name}"] = placed(self._movables[name], group)
        reset = lambda: self._set(first.values, 0.0)  # noqa: E731
        controls["reset"] = pressed("Back to the file's values", reset)
        controls["save"] = pressed("Write scene and pictures", lambda: self.save())
        return controls

    def _receive(self, message: Any) -> None:
        """Do what a message asks for; a ValueError says that the page offers nothing like it.

        A message sets a control, {"control": name, "value": value}, or drags a handle,
        {"handle": name, "position": [x, y, z], "ends": whether it is let go}.
        """
        match message:
            case {"control": str(name), "value": value, **others} if not others:
                control = self.controls.get(name)
                if control is not None and control.offers(value):
                    return control.act(value)
            case {"handle": str(name), "position": [_, _, _] as position, "ends": bool(ends)}:
                handle = self.handles.get(name)
                if handle is not None and all(map(_is_number, position)) and len(message) == 3:
                    with self._lock:
                        self._dragged = None if ends else handle
                        values = handle.values(np.array(position, float))
                        return self._set(values, 0.0 if ends else REST["handle"])
        raise ValueError(f"{message}")

    def _release(self) -> None:
        """Let go what a viewer who is gone may have dragged."""
        with self._lock:
            if self._dragged is not None:
                self._dragged = None
                self._change(0.0)

    # -- choices -----------------------------------------------------------------------------------

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
            self._publish_choice()

    def _publish_choice(self) -> None:
        """Show what is set: the controls' values, and where handles are."""
        values = {name: each.value() for name, each in self.controls.items()}
        handles = [
            {
                "name": name,
                "axes": each.axes,
                "position": each.position(self.choice.values).tolist(),
            }
            for name, each in self.handles.items()
        ]
        self.gate.publish(values=values, handles=handles)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number as a slider or a handle has them, and no truth value."""
    return type(value) in (int, float) and abs(value) <= 1e6  # NaN is not
