"""Run experiments one after the other and show on one page what they measured.

The folder ``sections`` keeps each experiment's section, and the page is renewed after it. A run
that was stopped continues by the same command: a section that the same code made from the same
inputs is made again only if it is named.
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
from experiments.report import Section, read_section, write_page, write_section
from experiments.setting import Setting
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.shipped import scenes_folder
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.storage.provenance import as_text, provenance

Experiment = Callable[..., Section]
"""Takes the page's `Inputs`; most take a `Setting`."""

Out = Annotated[Path, typer.Option(help="Folder to write.")]
Real = Annotated[Path | None, typer.Option(help="A real photograph of the chair scene, NPZ.")]
Rendered = Annotated[
    Path | None, typer.Option(help="Folder of what is rendered once; OUT/rendered unless given.")
]


class Inputs(Protocol):
    """What every experiment of a page gets, as a `Setting` is."""

    out: Path  # folder of the run
    seed: int  # of all that is drawn

    def identity(self) -> bytes:
        """Return what tells these inputs from others; a PeriscopyError where they are no use."""


@dataclass(frozen=True)
class Page:
    """Experiments that are shown together."""

    package: str  # of the experiments, such as ``experiments.paper``
    title: str
    introduction: str  # a paragraph above the claims
    names: Sequence[str]  # in the order shown: modules of the package with a function ``run``
    stated: str = "paper"  # heading of the claims' first values: who states them
    functions: Mapping[str, Experiment] = field(default_factory=dict)  # those that are no module
    on_demand: Sequence[str] = ()  # names of experiments that run only when named

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
        words = f"Run these alone, and anew, by comma: {', '.join(self.names)}."
        option: typer.models.OptionInfo = typer.Option(help=words)
        return option

    def carry_out(self, only: str, inputs: Callable[[], Inputs]) -> NoReturn:
        """Run all experiments, or those named, by comma, and end the command.

        Its exit code is 0, or 1 if an experiment failed, or 2, with one line, for what a user can
        fix; `inputs` may raise a PeriscopyError too.
        """
        named = [name.strip() for name in only.split(",")] if only else []
        with one_line_errors():
            for name in named:
                if name not in self.names:
                    known = ", ".join(self.names)
                    raise ps.PeriscopyError(f"no experiment '{name}'; there are {known}")
            given = inputs()
            names = named or [name for name in self.names if name not in self.on_demand]
            failures = run(self, names, given, anew=bool(named))
        print(f"wrote {given.out / 'index.html'}")
        raise typer.Exit(1 if failures else 0)


def run(page: Page, names: Sequence[str], inputs: Inputs, *, anew: bool = False) -> int:
    """Run experiments, and renew the page after each; return how many failed.

    One that fails does not stop the others. `anew` makes sections again that the same code made
    from the same inputs. A PeriscopyError says that the inputs cannot be used, such as a real
    photograph; no experiment has run then.
    """
    made_from, record = _digest(inputs), _record(page, inputs)
    failures = 0
    for name in names:
        file, how = _section_file(inputs.out, name), "kept"
        section = None if anew else read_section(file)
        if section is None or section.failure or section.made_from != made_from:
            section = replace(_attempt(page, name, inputs), made_from=made_from)
            write_section(file, section)
            how = section.took
        _write_report(page, inputs.out, record)
        print(f"{name}: {section.failure or section.title} ({how})", flush=True)
        failures += bool(section.failure)
    return failures


def _attempt(page: Page, name: str, inputs: Inputs) -> Section:
    """Run an experiment and note its time; the section of one that fails says why."""
    start, work = time.perf_counter(), processor_seconds()
    try:
        section = page.load(name)(inputs)
    except Exception as error:  # one that fails must not cost the others
        traceback.print_exc()
        section = Section(name, name, failure=f"{type(error).__name__}: {error}")
    seconds, work = time.perf_counter() - start, processor_seconds() - work
    return replace(section, took=f"{seconds:.1f} s, {work:.1f} s of processors' time")


def _write_report(page: Page, out: Path, record: Mapping[str, str]) -> None:
    """Write the page and the claims of all that a folder keeps."""
    kept = [read_section(_section_file(out, name)) for name in page.names]
    sections = [section for section in kept if section is not None]
    write_page(
        out / "index.html",
        page.title,
        sections,
        introduction=page.introduction,
        provenance=record,
        stated=page.stated,
    )
    claims = [{"section": each.name, **asdict(claim)} for each in sections for claim in each.claims]
    failed = {section.name: section.failure for section in sections if section.failure}
    summary = {"claims": claims, "failed": failed, "provenance": dict(record)}
    with staged_file(out / "claims.json") as file:
        file.write_text(json.dumps(summary, indent=2, ensure_ascii=False) + "\n", "utf-8")


def processor_seconds() -> float:
    """Return the processors' time that this process and its finished children have taken."""
    return sum(os.times()[:4])


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


def _section_file(out: Path, name: str) -> Path:
    return out / "sections" / f"{name}.json"


def _digest(inputs: Inputs) -> str:
    """Return the SHA-256 of all code, scenes and photographs that a section is made from."""
    digest = hashlib.sha256(str(inputs.seed).encode())
    digest.update(inputs.identity())
    for folder in (Path(ps.__file__).parent, Path(__file__).parent, scenes_folder()):
        for file in sorted(folder.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(file.read_bytes())
    return digest.hexdigest()


def _record(page: Page, inputs: Inputs) -> dict[str, str]:
    command = ["python", "-m", page.package, *sys.argv[1:]]
    made = provenance(read_document(ps.find_scene("chair")), inputs.seed, command)
    return as_text({**made, "processors": os.cpu_count()})
