"""Two sets of results of the same scans, as of two versions or two settings: what changed, worst first."""

from __future__ import annotations

import csv
import json
import math
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from . import page
from .problem import Problem

COLUMNS = ["scan", "change", "model_psnr_db", "lit_psnr_db", "light", "new_warnings", "gone_warnings", "decisions"]

# From good to bad.
KINDS = ["identical", "only in B", "changed", "only in A"]


@dataclass(frozen=True)
class Change:
    """What changed in one scan from A to B. Differences of PSNR are means over validation frames, B − A."""

    name: str
    kind: str
    model_psnr_db: Optional[float] = None
    lit_psnr_db: Optional[float] = None
    # |light of B − light of A| / |light of A|, over the bands of both.
    light: Optional[float] = None
    new_warnings: tuple[str, ...] = ()
    gone_warnings: tuple[str, ...] = ()
    decisions: tuple[str, ...] = ()

    @property
    def badness(self) -> tuple[bool, float, int, float, int]:
        """Greater is worse: results that are gone, then worse predictions, then new warnings, then other light."""
        is_gone, psnr_db, light = self.kind == "only in A", self.model_psnr_db or 0.0, self.light or 0.0
        return (is_gone, -psnr_db, len(self.new_warnings), light, KINDS.index(self.kind))


def compare(a: Path, b: Path, lumiscan: Path) -> list[Change]:
    """Every scan of either set, worst first."""
    sets = [_results(a), _results(b)]
    names = sorted(sets[0].keys() | sets[1].keys())
    changes = [_change(name, sets[0].get(name), sets[1].get(name), lumiscan) for name in names]
    return sorted(changes, key=lambda change: change.badness, reverse=True)


def write(out: Path, a: Path, b: Path, changes: list[Change]) -> None:
    """Writes `compare.csv` and `compare.html`."""
    with (out / "compare.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for c in changes:
            lists = ["; ".join(items) for items in (c.new_warnings, c.gone_warnings, c.decisions)]
            table.writerow([c.name, c.kind, c.model_psnr_db, c.lit_psnr_db, c.light, *lists])
    path = out / "compare.html"
    counts = ", ".join(f"{sum(c.kind == k for c in changes)} {k}" for k in reversed(KINDS))
    introduction = f"A: {a} · B: {b} · {counts}. Worst first. PSNR and light: B against A."
    page.write(path, "What changed", introduction, ["A", "B"] + COLUMNS, [_row(c, a, b, path) for c in changes])


def _row(c: Change, a: Path, b: Path, path: Path) -> list[page.Cell]:
    pictures = [page.picture(s / c.name / "preview.png", path, s / c.name / "viewer.html") for s in (a, b)]
    lists = [page.listing(items) for items in (c.new_warnings, c.gone_warnings, c.decisions)]
    return [*pictures, c.name, c.kind, c.model_psnr_db, c.lit_psnr_db, c.light, *lists]


def _results(folder: Path) -> dict[str, Path]:
    found = {str(path.parent.relative_to(folder)): path for path in sorted(folder.rglob("result.lres"))}
    if not found:
        raise Problem(f"{folder}: there is no result in it")
    return found


def _change(name: str, a: Optional[Path], b: Optional[Path], lumiscan: Path) -> Change:
    if a is None or b is None:
        return Change(name, "only in B" if a is None else "only in A")
    if a.read_bytes() == b.read_bytes():
        return Change(name, "identical")
    before, after = _inspect(a, lumiscan), _inspect(b, lumiscan)
    warnings = [set(r["warnings"]) for r in (before, after)]
    choices = [{d["name"]: d["choice"] for d in r["decisions"]} for r in (before, after)]
    changed = [n for n in choices[0].keys() | choices[1].keys() if choices[0].get(n) != choices[1].get(n)]
    return Change(
        name,
        "changed",
        _difference(before, after, "model_psnr_db"),
        _difference(before, after, "lit_psnr_db"),
        _light(before["light"], after["light"]),
        tuple(sorted(warnings[1] - warnings[0])),
        tuple(sorted(warnings[0] - warnings[1])),
        tuple(f"{n}: {choices[0].get(n, 'none')} → {choices[1].get(n, 'none')}" for n in sorted(changed)),
    )


def _inspect(path: Path, lumiscan: Path) -> dict[str, Any]:
    run = subprocess.run([str(lumiscan), "--json", "inspect", str(path)], capture_output=True, text=True)
    if run.returncode != 0:
        raise Problem(f"{path}: {run.stderr.strip()}", code=1)
    return json.loads(run.stdout)


def _difference(before: dict[str, Any], after: dict[str, Any], key: str) -> Optional[float]:
    """Difference of the means over the validation frames that both predict."""
    values = [{w["name"]: w[key] for w in r["witnesses"] if w[key] is not None} for r in (before, after)]
    shared = values[0].keys() & values[1].keys()
    return sum(values[1][n] - values[0][n] for n in sorted(shared)) / len(shared) if shared else None


def _light(before: list[list[float]], after: list[list[float]]) -> Optional[float]:
    pairs = [(x, y) for p, q in zip(before, after) for x, y in zip(p, q)]
    size = math.sqrt(sum(x * x for x, _ in pairs))
    return math.sqrt(sum((y - x) ** 2 for x, y in pairs)) / size if size > 0 else None
