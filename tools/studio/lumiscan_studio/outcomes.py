"""How the estimates ended."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

# What is said of a process that left no line: killed with its worker, or not started at all.
SILENT = {"outcome": "failed", "retry": "elsewhere", "problem": "it did not run to its end"}


@dataclass(frozen=True)
class Outcome:
    """The line that `lumiscan --json estimate` printed."""

    name: str
    folder: Path
    line: dict[str, Any]

    @property
    def has_result(self) -> bool:
        return self.line["outcome"] in ("done", "unchanged", "partial")

    @property
    def problem(self) -> str:
        return self.line.get("problem") or ""

    @property
    def warnings(self) -> list[str]:
        return self.line.get("warnings", [])

    @property
    def cuts(self) -> list[str]:
        return self.line.get("cuts", [])

    @property
    def decisions(self) -> dict[str, str]:
        return {d["name"]: d["choice"] for d in self.line.get("decisions", [])}

    @property
    def seconds(self) -> Optional[float]:
        return dict(self.line.get("seconds", [])).get("total")

    @property
    def cpu_seconds(self) -> Optional[float]:
        return self.line.get("cpu_seconds")

    @property
    def memory_mb(self) -> Optional[float]:
        peak = self.line.get("memory_peak_bytes")
        return peak / 1e6 if peak else None


def read(name: str, folder: Path, error: Optional[str] = None) -> Outcome:
    """The outcome of a scan whose task ended with `error`, or well. What an unchanged result once cost is taken from `made.json`."""
    line = _line(folder / "outcome.json")
    if line is None or (error is not None and not line.get("problem")):
        line = {**SILENT, **({"problem": error} if error else {})}
    made = folder / "made.json"
    if line["outcome"] in ("done", "partial"):
        made.write_text(json.dumps(line))
    elif line["outcome"] == "unchanged":
        before = _line(made) or {}
        if before.get("origin") == line.get("origin"):
            line |= {key: before[key] for key in ("seconds", "cpu_seconds", "memory_peak_bytes") if key in before}
    return Outcome(name, folder, line)


def _line(path: Path) -> Optional[dict[str, Any]]:
    try:
        line = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return line if isinstance(line, dict) and "outcome" in line else None
