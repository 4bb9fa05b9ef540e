"""Finds scan files and names them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Iterable, Iterator

from .problem import Problem


@dataclass(frozen=True)
class Scan:
    """A scan file and the folder, below the output folder, that its result gets."""

    name: str
    path: Path

    @property
    def megabytes(self) -> float:
        return self.path.stat().st_size / 1e6


def find(paths: Iterable[Path]) -> list[Scan]:
    """Scans from files and folders, sorted by name. A folder is searched to any depth; hidden folders are work in progress."""
    found: dict[str, Scan] = {}
    for path in paths:
        if not path.exists():
            raise Problem(f"{path}: there is no such file or folder")
        base = path if path.is_dir() else _folder(path).parent
        for file in _files(path):
            name = str(_folder(file).relative_to(base))
            scan = Scan(name, file.resolve())
            other = found.setdefault(name, scan)
            if other.path != scan.path:
                raise Problem(f"{other.path} and {scan.path} are both named {name}; give the folder that holds both instead")
    if not found:
        raise Problem("there is no scan file (.lscan) in " + ", ".join(map(str, paths)))
    return sorted(found.values(), key=lambda scan: scan.name)


def _files(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
        return
    for file in sorted(path.rglob("*.lscan")):
        if not any(part.startswith(".") for part in file.relative_to(path).parts):
            yield file


def _folder(file: Path) -> Path:
    """`a/b` for `a/b/scan.lscan`, as in a device folder, and for `a/b.lscan`."""
    file = file.absolute()
    return file.parent if file.name == "scan.lscan" else file.with_suffix("")
