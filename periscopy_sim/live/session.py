"""A laboratory that follows a person's choices, on a page that all viewers share.

The page has handles in the scene and controls beside it. It computes nothing: `page.js` draws what
`Gate.publish` sends, and sends what a person sets.
"""

import logging
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from threading import Event, Thread
from typing import Any, Self

import numpy as np
from threadpoolctl import threadpool_limits

from periscopy_sim.errors import PeriscopyError, require
from periscopy_sim.live.looks import Movable, find_movables, images_in, mesh_of, panels_of, room_of
from periscopy_sim.live.pictures import (  # fmt: skip
    Check,
    Choice,
    LivePictures,
    Overtaken,
    SizedLaboratory,
    coarse,
)
from periscopy_sim.numerics import Array, Mask, validation
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import scenes_folder

LOG = logging.getLogger(__name__)
Job = Callable[[], None]
Describe = Callable[[Report], Sequence[str]]

REST = {"slider": 0.3, "handle": 1.0}
"""Seconds after which a control counts as at rest; only a handle reports its release. After the
longer ones a further change of the same numbers is another move."""

IN_SPACE = 0.2
"""Seconds between two frames of a stream in the 3-D view, which some browsers draw in software."""

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


class LiveSession:
    """A laboratory on a page that follows a person's choices; a context, which closes the page.

    It shows coarse pictures at once, full ones at rest. There is no queue: it takes the latest
    choice when it is free, and a newer one ends full pictures.

    `scenario` has its full sizes, and `first` lacks the scene's values; a viewer chooses among the
    shipped images, if it has one, and the methods. `save` gets the full pictures when the page's
    button is pressed, and returns a line to show; `describe` returns a report's sentences. For
    `photograph`, `light` and `seed` see `SizedLaboratory`; `mask` says which pixels are used of
    what a function returns. `choice` is the present one, `gate` serves the page, at port 0 a free
    one. A PeriscopyError says that the extra is not installed, the port is taken, or nothing of
    the scene can be moved.
    """

    def __init__(
        self,
        scenario: Scenario,
        first: Choice,
        save: Callable[[LivePictures], str],
        describe: Describe,
        *,
        photograph: Photograph | Callable[[], Photograph] | None = None,
        mask: Mask | None = None,
        light: Array | None = None,
        seed: int = 0,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        require("websockets")
        from periscopy_sim.live.gate import Gate

        mask = photograph.pixels if isinstance(photograph, Photograph) else mask
        small = coarse(scenario, 1.0 if mask is None else float(mask.mean()))
        self._coarse = SizedLaboratory(small, photograph, light, is_coarse=True, seed=seed)
        self._full = SizedLaboratory(scenario, photograph, light, is_coarse=False, seed=seed)
        self._behind = list[SizedLaboratory]()  # the latest choice, coarse before full
        self._changed, self.ended, self._jobs = Event(), Event(), list[Job]()
        self._done: Choice | None = None  # in full
        self._rests = 0.0  # when the latest choice counts as at rest
        self._save, self.steps = save, list[Job]()  # what runs beside it, each in a thread
        self._describe = describe
        movables, handles = find_movables(small)
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
            room=room_of(small), trouble=["computing the first pictures"],
            controls=[{"id": name, **each.look} for name, each in self.controls.items()],
        )  # fmt: skip
        self._refresh()

    def show(self, pictures: LivePictures, **parts: Any) -> None:
        """Show pictures with their captions and notes, and other parts of the state."""
        size = "coarse" if pictures.is_coarse else "full"
        notes = *self._describe(pictures.report), f"{size} pictures in {pictures.seconds:.1f} s"
        # A scene that has not moved keeps its occluders, and shows some of a stream's frames.
        is_moved, self._drawn = pictures.scenario is not self._drawn, pictures.scenario
        now = time.monotonic()
        if is_moved:
            parts["occluders"] = [mesh_of(each) for each in pictures.scenario.view.occluders]
        if is_moved or pictures.frame is None or now >= self._space_due:
            parts |= images_in(pictures)
            self._space_due = now + IN_SPACE
        self.gate.publish(panels=panels_of(pictures), notes=notes, **parts)

    def show_trouble(self, text: str, *, is_coarse: bool = False) -> None:  # noqa: ARG002
        """Show why there are no pictures of the present choice, or no coarse ones, or nothing."""
        self.gate.publish(trouble=[text] if text else [])

    def follow(self, laboratory: SizedLaboratory, choice: Choice, check: Check) -> None:
        """Compute and show the pictures of a choice; for `check` see `SizedLaboratory.fit`."""
        pictures = laboratory.fit(choice, check).pictures()
        check()
        self.show(pictures)

    def want(self, rest: float = 0.0) -> None:
        """Follow the present choice; in full, unless another one comes within so many seconds."""
        self._rests = time.monotonic() + rest
        is_done, self._done = self._done == self.choice, None  # it is not shown coarsely again
        self._behind = [self._full] if is_done else [self._coarse, self._full]
        self._changed.set()

    def save(self) -> None:
        """Save the full pictures of the present choice, and show the line that this returns."""

        def write() -> None:
            self.gate.publish(trouble=[self._save(self._full.fit(self.choice).pictures())])

        self.at_rest(write)

    def at_rest(self, job: Job) -> None:
        """Call a function once the latest choice is done in full, or has failed; do so at once."""
        self._jobs.append(job)
        self._rests = 0.0
        self._changed.set()

    def stop(self) -> None:
        """End `run` after the present stage of its work."""
        self.ended.set()
        self._changed.set()

    def run(self) -> None:
        """Show whatever is set, until `stop`."""
        # Coarse pictures, full ones and the browser share the cores: products split among threads
        # would wait for each other, and 0.1 s become seconds.
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures that are gone in a moment
            self.want()
            for step in self.steps:
                Thread(target=step, daemon=True).start()
            while (work := self._next()) is not None:
                laboratory, job = work
                try:
                    job()
                except Overtaken:
                    pass
                except Exception as error:  # one choice that fails must not end the page
                    fault = error
                    if not isinstance(error, PeriscopyError):
                        LOG.error("the page goes on after an error", exc_info=error)
                        fault = PeriscopyError(f"{type(error).__name__}: {error}")
                    self.show_trouble(str(fault), is_coarse=laboratory is self._coarse)

    def _next(self) -> tuple[SizedLaboratory | None, Job] | None:
        """Wait for a laboratory that is behind the latest choice, or for another job."""
        while not self.ended.is_set():
            self._changed.clear()  # before a look at what is wanted: no change is missed
            pause, behind = None, self._behind
            if behind:
                pause = 0.0 if behind[0] is self._coarse else self._rests - time.monotonic()
                if pause <= 0:
                    laboratory = behind.pop(0)
                    return laboratory, partial(self._follow, laboratory, self.choice)
            elif self._jobs:
                return None, self._jobs.pop(0)
            self._changed.wait(pause)
        return None

    def _follow(self, laboratory: SizedLaboratory, choice: Choice) -> None:
        def check(*_: object) -> None:
            # Coarse pictures are finished, so that a drag shows some.
            if self.ended.is_set() or (laboratory is self._full and self._coarse in self._behind):
                raise Overtaken

        self.follow(laboratory, choice, check)
        self._done = choice if laboratory is self._full else None
        self.show_trouble("")

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

        controls = {"method": chosen("Method", "method", *METHODS, first.method)}
        if first.image:
            images = sorted(file.stem for file in (scenes_folder() / "images").glob("*.png"))
            controls["image"] = chosen("Hidden image", "image", *images, first.image)
            controls["snr"] = slider(
                Movable("SNR", first.snr, 20.0, 80.0, 1.0, validation.RANGES["decibels"].unit), "",
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

    def __enter__(self) -> Self:
        """Return the session, whose page is open."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all."""
        self.stop()
        self.gate.close()

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
