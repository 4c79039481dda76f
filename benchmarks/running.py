"""Run suites by benchopt: one file of results for each suite."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.suites import SUITES, VERSION
from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.storage.outputs import staged_file

HERE = Path(__file__).parent


def known_methods() -> tuple[str, ...]:
    """Return the methods' names: those of the registry, and files of ``solvers``."""
    files = {file.stem.replace("_", "-") for file in (HERE / "solvers").glob("*.py")}
    return (*METHODS, *sorted(files - {"registry"}))


def checked(kind: str, names: Sequence[str], known: Sequence[str]) -> list[str]:
    """Return names that exist; a PeriscopyError says which does not and what there is."""
    for name in names:
        if name not in known:
            guess = did_you_mean(name, known)
            raise PeriscopyError(f"no {kind} '{name}'; {guess} there are {', '.join(known)}")
    return list(names)


def run_suite(suite: str, methods: Sequence[str], results: Path) -> None:
    """Run methods, or all if none is named, on a suite; renew their rows in its file of results.

    Rows of other methods and of this version of the suites are kept.
    """
    import pandas
    from benchopt.results import read_results
    from benchopt.runner import run_benchmark

    patterns = [f"registry[method={name}]" if name in METHODS else name for name in methods]
    with tempfile.TemporaryDirectory() as folder:
        made = run_benchmark(
            str(HERE),
            solver_names=patterns or None,
            dataset_names=[suite],
            n_jobs=1,
            plot_result=False,
            no_cache=True,  # its cache does not see changes of the package
            output_file=str(Path(folder) / "results.parquet"),
        )
        rows = read_results(made)
        file = results / f"{suite}.parquet"
        if methods and file.is_file():
            held = read_results(file)
            others = ~held.objective_label.isin(set(rows.objective_label))
            rows = pandas.concat([held[others & (held.objective_version == VERSION)], rows])
        results.mkdir(parents=True, exist_ok=True)
        with staged_file(file) as staged:
            rows.to_parquet(staged)


def read_rows(results: Path) -> Any:
    """Return the rows of all suites that were run under this version, as benchopt keeps them."""
    import pandas
    from benchopt.results import read_results

    files = [results / f"{suite}.parquet" for suite in SUITES]
    tables = [read_results(file) for file in files if file.is_file()]
    if not tables:
        raise PeriscopyError(f"{results}: holds no results; run a suite first")
    rows = pandas.concat(tables, ignore_index=True)
    rows = rows[rows.objective_version == VERSION]
    named = {name: name.removeprefix("objective_") for name in rows if name[:9] == "objective"}
    return rows.rename(columns=named)
