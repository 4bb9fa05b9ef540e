"""The table over all results: `summary.csv` for programs, `summary.html` for people."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Sequence

from . import page
from .outcomes import Outcome

COLUMNS = ["scan", "outcome", "problem", "retry", "vertices", "seconds", "cpu_seconds", "memory_mb", "warnings", "cuts"]


def write(out: Path, outcomes: Sequence[Outcome]) -> None:
    """Writes both tables. Every decision that a result records gets a column of the CSV."""
    decisions = sorted({name for outcome in outcomes for name in outcome.decisions})
    with (out / "summary.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS + decisions)
        for o in outcomes:
            lists = ["; ".join(o.warnings), "; ".join(o.cuts)]
            table.writerow(_figures(o) + lists + [o.decisions.get(name, "") for name in decisions])
    path = out / "summary.html"
    heads = ["preview"] + COLUMNS + ["decisions"]
    page.write(path, f"{len(outcomes)} scans", counted(outcomes), heads, [_row(o, path) for o in outcomes])


def counted(outcomes: Sequence[Outcome]) -> str:
    """How many ended how."""
    kinds = [o.line["outcome"] for o in outcomes]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds)))


def _figures(o: Outcome) -> list[page.Cell]:
    costs = [None if cost is None else round(cost, 3) for cost in (o.seconds, o.cpu_seconds, o.memory_mb)]
    return [o.name, o.line["outcome"], o.problem, o.line.get("retry"), o.line.get("vertices") or None, *costs]


def _row(o: Outcome, path: Path) -> list[page.Cell]:
    preview = page.picture(o.folder / "preview.png", path, o.folder / "viewer.html") if o.has_result else None
    decisions = page.listing(f"{name}: {choice}" for name, choice in o.decisions.items())
    return [preview, *_figures(o), page.listing(o.warnings), page.listing(o.cuts), decisions]
