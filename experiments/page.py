"""Run experiments one after the other and show on one page what they found.

What each found is kept in the folder ``sections`` and on the page before the next begins. A run
that was stopped goes on by the same command: a section that the same code made from the same
inputs is not made again, unless it is named.
"""

import hashlib
import importlib
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, NoReturn, Protocol

import typer

import periscopy_sim as ps
from experiments.drawing import styled
from experiments.report import Section, read_section, write_page, write_section
from experiments.setting import Setting
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.shipped import scenes_folder
from periscopy_sim.storage.outputs.provenance import as_text, provenance
from periscopy_sim.storage.outputs.staging import staged_file

Experiment = Callable[..., Section]
"""Takes the page's `Inputs`; most take a `Setting`."""

Out = Annotated[Path, typer.Option(help="Folder to write.")]
Real = Annotated[Path | None, typer.Option(help="A real photograph of the chair scene, NPZ.")]
Rendered = Annotated[
    Path | None, typer.Option(help="Folder of what is rendered once; OUT/rendered unless given.")
]


class Inputs(Protocol):
    """What every experiment of a page gets, as a `Setting` is."""

    out: Path
    """Folder of the run."""

    seed: int
    """Of all that is drawn."""

    def identity(self) -> bytes:
        """Return what tells these inputs from others; a PeriscopyError where they are no use."""


@dataclass(frozen=True)
class Page:
    """Experiments that are shown together.

    Attributes
    ----------
    package
        Python package of the experiments, such as ``experiments.paper``.
    title
        Heading of the page.
    introduction
        A paragraph above the claims.
    names
        Of the experiments, in the order shown: modules of the package with a function ``run``.
    stated
        Heading of the claims' first values: who states them.
    functions
        Experiments that are no module of their own, by name.
    on_demand
        Names of experiments that run only when named.
    """

    package: str
    title: str
    introduction: str
    names: Sequence[str]
    stated: str = "paper"
    functions: Mapping[str, Experiment] = field(default_factory=dict)
    on_demand: Sequence[str] = ()

    def load(self, name: str) -> Experiment:
        """Return one experiment; nothing of the others is imported."""
        if name in self.functions:
            return self.functions[name]
        experiment: Experiment = importlib.import_module(f"{self.package}.{name}").run
        return experiment

    def command(self) -> Callable[..., None]:
        """Return the page's command, for typer."""

        def main(
            out: Out,
            only: Annotated[str, self.choice()] = "",
            real: Real = None,
            rendered: Rendered = None,
        ) -> None:
            self.carry_out(only, lambda: Setting(out, real, rendered))

        main.__doc__ = f"{self.title}: run the experiments and write the page."
        return main

    def choice(self) -> typer.models.OptionInfo:
        """Return the option that names the experiments to run."""
        known = ", ".join(self.names)
        option: typer.models.OptionInfo = typer.Option(
            help=f"Run these alone, and anew, by comma: {known}."
        )
        return option

    def carry_out(self, only: str, inputs: Callable[[], Inputs]) -> NoReturn:
        """Run all experiments, or those named, by comma, and end the command.

        Its exit code is 0, or 1 if an experiment failed, or 2, with one line, for what a user can
        fix; `inputs` may raise a PeriscopyError too.
        """
        names = [name for name in self.names if name not in self.on_demand]
        chosen = [name.strip() for name in only.split(",")] if only else names
        with one_line_errors():
            for name in chosen:
                if name not in self.names:
                    known = ", ".join(self.names)
                    raise ps.PeriscopyError(f"no experiment '{name}'; there are {known}")
            given = inputs()
            failures = run(self, chosen, given, anew=bool(only))
        print(f"wrote {given.out / 'index.html'}")
        raise typer.Exit(1 if failures else 0)


def run(page: Page, names: Sequence[str], setting: Inputs, *, anew: bool = False) -> int:
    """Run experiments, and renew the page after each.

    Parameters
    ----------
    page
        The page.
    names
        Of the experiments.
    setting
        What each of them gets.
    anew
        Whether to make sections again that the same code made from the same inputs.

    Returns
    -------
    int
        How many failed; the others were run all the same.

    Raises
    ------
    PeriscopyError
        If the inputs cannot be used, such as a real photograph; no experiment has run then.
    """
    made_from = _digest(setting)
    record = _record(page, setting)
    failures = 0
    for name in names:
        file = _section_file(setting.out, name)
        section = read_section(file) if file.is_file() and not anew else None
        if section is None or section.failure or section.made_from != made_from:
            section = replace(_attempt(page, name, setting), made_from=made_from)
            write_section(file, section)
            how = took(section)
        else:
            how = "kept"
        write_report(page, setting.out, record)
        print(f"{name}: {section.failure or section.title} ({how})", flush=True)
        failures += bool(section.failure)
    return failures


def write_report(page: Page, out: Path, record: Mapping[str, str]) -> None:
    """Write the page and the claims of all that is kept in a folder."""
    files = [_section_file(out, name) for name in page.names]
    sections = [read_section(file) for file in files if file.is_file()]
    write_page(
        out / "index.html",
        page.title,
        sections,
        introduction=page.introduction,
        provenance=record,
        stated=page.stated,
    )
    claims = [
        {"section": section.name, **asdict(claim)}
        for section in sections
        for claim in section.claims
    ]
    failed = {section.name: section.failure for section in sections if section.failure}
    summary = {"claims": claims, "failed": failed, "provenance": dict(record)}
    with staged_file(out / "claims.json") as file:
        file.write_text(json.dumps(summary, indent=2, ensure_ascii=False) + "\n", "utf-8")


def timed(experiment: Experiment, setting: Inputs) -> Section:
    """Run an experiment and note how long it took, and the processors' time in all."""
    start, work = time.perf_counter(), processor_seconds()
    with styled():
        section = experiment(setting)
    return replace(
        section,
        seconds=time.perf_counter() - start,
        processor_seconds=processor_seconds() - work,
    )


def processor_seconds() -> float:
    """Return the processors' time that this process and its finished children have taken."""
    return sum(os.times()[:4])


def took(section: Section) -> str:
    """Return a section's times in words."""
    if section.seconds is None or section.processor_seconds is None:
        return "failed"
    return f"{section.seconds:.1f} s, {section.processor_seconds:.1f} s of processors' time"


def described(docstring: str | None) -> str:
    """Return a module's docstring after its first line as one paragraph, commands left out."""
    paragraphs = (docstring or "").strip().split("\n\n")[1:]
    return " ".join(" ".join(p for p in paragraphs if not p.startswith("`python")).split())


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn a user's mistake into one line and exit code 2."""
    try:
        yield
    except ps.PeriscopyError as error:
        print(f"error: {error}", file=sys.stderr)
        raise typer.Exit(2) from None


def _attempt(page: Page, name: str, setting: Inputs) -> Section:
    try:
        return timed(page.load(name), setting)
    except Exception as error:  # one that fails must not cost the others
        traceback.print_exc()
        return Section(name, name, failure=f"{type(error).__name__}: {error}")


def _section_file(out: Path, name: str) -> Path:
    return out / "sections" / f"{name}.json"


def _digest(setting: Inputs) -> str:
    """Return the SHA-256 of all code, scenes and photographs that a section is made from."""
    digest = hashlib.sha256(str(setting.seed).encode())
    digest.update(setting.identity())
    for folder in (Path(ps.__file__).parent, Path(__file__).parent, scenes_folder()):
        for file in sorted(folder.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(file.read_bytes())
    return digest.hexdigest()


def _record(page: Page, setting: Inputs) -> dict[str, str]:
    command = ["python", "-m", page.package, *sys.argv[1:]]
    chair = read_document(ps.find_scene("chair"))
    made = provenance(chair, setting.seed, command)
    return as_text({**made, "processors": os.cpu_count()})
