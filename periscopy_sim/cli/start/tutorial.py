"""`periscopy tutorial`: a copy of the tutorial's files."""

from __future__ import annotations

import shutil

from periscopy_sim.cli.options import Out
from periscopy_sim.cli.output import output_folder, say
from periscopy_sim.errors import OutputError
from periscopy_sim.shipped import scenes_folder


def tutorial(out: Out) -> None:
    """Copy the tutorial's files; overwrite nothing."""
    shipped = scenes_folder() / "tutorial"
    for file in sorted(shipped.rglob("*")):
        own = out / file.relative_to(shipped)
        if file.is_file() and own.exists():
            raise OutputError(f"{own} exists already and stays; name another folder")
    with output_folder(out) as folder:
        # Not their modes: an installed package may be read-only.
        shutil.copytree(shipped, folder, copy_function=shutil.copyfile, dirs_exist_ok=True)
    say(f"begin with: periscopy lab {out / 'measurements.yaml'} --out lab.xml")
