"""The page that shows a laboratory: handles in its scene, controls beside it.

All viewers see and set the same. The page computes nothing: `page.js` draws what `Gate.publish`
sends, and sends what a person sets.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from periscopy_sim.extras import require
from periscopy_sim.live.looks import images_in, mesh_of, panels_of, room_of
from periscopy_sim.live.movable import Movable, find_movables
from periscopy_sim.live.pictures import Choice, LivePictures
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.reconstruction.registry import installed_methods
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import scenes_folder

REST = {"slider": 0.3, "handle": 1.0}
"""Seconds after which a control counts as at rest; only a handle reports its release. After the
longer ones a further change of the same numbers is another move."""

IN_SPACE = 0.2
"""Seconds between two frames of a stream in the 3-D view, which some browsers draw in software."""

SBRS = 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0
"""The signal-to-background ratios of the page's list."""

Describe = Callable[[Report], Sequence[str]]


@dataclass(frozen=True)
class Control:
    """A control of the page: how it looks, which values it offers, and what setting one does.

    `look` is what `page.js` draws; `value` returns the present value of the choice.
    """

    look: Mapping[str, Any]
    offers: Callable[[Any], bool]
    act: Callable[[Any], None]
    value: Callable[[], Any]


def button(label: Callable[[], str], act: Callable[[], None]) -> Control:
    """Return a button, whose value is its present label."""
    return Control({"kind": "button"}, lambda value: value is True, lambda _: act(), label)


def slider(
    number: Movable, group: str, act: Callable[[float], None], value: Callable[[], float]
) -> Control:
    """Return a slider of a number, and a field to type it."""
    unit = f" ({number.unit})" if number.unit else ""
    return Control(
        {"kind": "slider", "group": group, "label": f"{number.name}{unit}"}
        | {"low": number.low, "high": number.high, "step": number.step},
        lambda value: _is_number(value) and number.low <= value <= number.high,
        lambda value: act(float(value)),
        value,
    )


class Page(ABC):
    """A page on a port of this computer, 0 for a free one; at first without pictures, see `show`.

    A viewer chooses among the shipped images, if the `first` choice has one, and the methods.
    `describe` returns a report's sentences. `choice` is the present one, `gate` serves the page. A
    PeriscopyError says that the extra is not installed, the port is taken, or nothing of the scene
    can be moved.
    """

    def __init__(
        self, host: str, port: int, scenario: Scenario, first: Choice, describe: Describe
    ) -> None:
        require("websockets")
        from periscopy_sim.live.gate import Gate

        self._describe = describe
        movables, handles = find_movables(scenario)
        self._movables = {each.name: each for each in movables}
        self.handles = {each.name: each for each in handles}
        self.choice = replace(first, values={each.name: each.value for each in movables})
        self._moves = list[Mapping[str, float]]()  # values before each
        self._moved, self._moved_at = frozenset[str](), 0.0
        self._drawn: Scenario | None = None
        self._space_due = 0.0  # when the 3-D view shows a frame again
        self.controls = self._controls()
        self.gate = Gate(host, port, self._receive)
        self.gate.publish(
            room=room_of(scenario), trouble=["computing the first pictures"],
            controls=[{"id": name, **each.look} for name, each in self.controls.items()],
        )  # fmt: skip
        self._refresh()

    def show(self, pictures: LivePictures, **parts: Any) -> None:
        """Show pictures with their captions and notes, and other parts of the state."""
        size = "coarse" if pictures.is_coarse else "full"
        notes = *self._describe(pictures.report), f"{size} pictures in {pictures.seconds:.1f} s"
        panels = [each.look() for each in panels_of(pictures)]
        # A scene that has not moved keeps its occluders, and shows some of a stream's frames.
        is_moved, self._drawn = pictures.scenario is not self._drawn, pictures.scenario
        now = time.monotonic()
        if is_moved:
            parts["occluders"] = [mesh_of(each) for each in pictures.scenario.view.occluders]
        if is_moved or pictures.frame is None or now >= self._space_due:
            parts |= images_in(pictures)
            self._space_due = now + IN_SPACE
        self.gate.publish(panels=panels, notes=notes, **parts)

    def show_trouble(self, text: str, *, is_coarse: bool = False) -> None:  # noqa: ARG002
        """Show why there are no pictures of the present choice, or no coarse ones; or nothing."""
        self.gate.publish(trouble=[text] if text else [])

    @abstractmethod
    def want(self, rest: float = 0.0) -> None:
        """Follow the present choice, which counts as at rest after so many seconds."""

    @abstractmethod
    def save(self) -> None:
        """Do what the page's button is for."""

    def further_controls(self) -> Mapping[str, Control]:
        """Return further controls of the page, by name."""
        return {}

    def _controls(self) -> dict[str, Control]:
        """Return the page's controls, by the names in its messages, from top to bottom."""
        first = self.choice

        def chosen(label: str, field: str, *offered: str | float) -> Control:
            options = {str(each) or "none": each for each in offered}
            return Control(
                {"kind": "choice", "label": label, "options": list(options)},
                lambda value: isinstance(value, str) and value in options,
                lambda value: self._change(0.0, **{field: options[value]}),
                lambda: str(getattr(self.choice, field)) or "none",
            )

        def placed(name: str, group: str) -> Control:
            act = lambda value: self._set({name: value}, REST["slider"])  # noqa: E731
            return slider(self._movables[name], group, act, lambda: self.choice.values[name])

        controls = {"method": chosen("Method", "method", *installed_methods(), first.method)}
        if first.image:
            images = sorted(file.stem for file in (scenes_folder() / "images").glob("*.png"))
            controls["image"] = chosen("Hidden image", "image", *images, first.image)
            controls["snr"] = slider(
                Movable("SNR", first.snr, 20.0, 80.0, 1.0, "dB"), "",
                lambda snr: self._change(REST["slider"], snr=snr), lambda: self.choice.snr,
            )  # fmt: skip
        if first.place:
            controls["place"] = chosen("Ambient light", "place", first.place, "")
            controls["sbr"] = chosen("SBR", "sbr", *SBRS)
        placing = {name for handle in self.handles.values() for name in handle.names}
        groups = {"Positions": placing, "Other parameters": self._movables.keys() - placing}
        for group, names in groups.items():
            for name in filter(names.__contains__, self._movables):
                controls[f"value {name}"] = placed(name, group)
        reset = button(lambda: "Reset to the file's values", lambda: self._set(first.values, 0.0))
        return {
            **controls,
            "undo": button(lambda: "Undo the last move (Ctrl+Z)", self._undo),
            "reset": reset,
            **self.further_controls(),
            "save": button(lambda: "Set: write scene and pictures", self.save),
        }

    # -- in the server's thread --------------------------------------------------------------------

    def _receive(self, message: Any) -> None:
        """Do what a message asks for; a ValueError says that the page offers nothing like it.

        A message sets a control, {"control": name, "value": value}, or drags a handle,
        {"handle": name, "position": [x, y, z], "ends": whether it is let go}.
        """
        match message:
            case {"control": str(name), "value": value, **more} if (
                not more and name in self.controls and self.controls[name].offers(value)
            ):
                self.controls[name].act(value)
            case {"handle": str(name), "position": [_, _, _] as to, "ends": bool(ends), **more} if (
                not more and name in self.handles and all(map(_is_number, to))
            ):
                values = self.handles[name].values(np.array(to, float))
                self._set(values, 0.0 if ends else REST["handle"])
                self._moved = frozenset() if ends else self._moved
            case _:
                raise ValueError(f"{message}")
        self._refresh()

    def _set(self, values: Mapping[str, float], rest: float) -> None:
        limits, names, now = self._movables, frozenset(values), time.monotonic()
        within = {n: min(max(v, limits[n].low), limits[n].high) for n, v in values.items()}
        within = {**self.choice.values, **within}
        is_other = names != self._moved or now - self._moved_at > REST["handle"]
        if is_other and within != self.choice.values:
            self._moves.append(self.choice.values)
        self._moved, self._moved_at = names, now
        self._change(rest, values=within)

    def _undo(self) -> None:
        if self._moves:
            self._moved = frozenset()
            self._change(0.0, values=self._moves.pop())

    def _change(self, rest: float, **changes: Any) -> None:
        self.choice = replace(self.choice, **changes)
        self.want(rest)

    def _refresh(self) -> None:
        """Show what is set: the controls' values, and where handles are."""
        values = self.choice.values
        handles = [
            {"name": name, "axes": of.directions.any(axis=0).tolist()}
            | {"position": of.position(values).tolist()}
            for name, of in self.handles.items()
        ]
        shown = {name: control.value() for name, control in self.controls.items()}
        self.gate.publish(values=shown, handles=handles)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number as a slider or a handle has them, and no truth value."""
    return type(value) in (int, float) and abs(value) <= 1e6  # NaN is not
