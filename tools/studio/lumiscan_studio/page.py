"""Pages that any browser opens, without network."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Iterable, Optional, Sequence, Union
from urllib.parse import quote


@dataclass(frozen=True)
class Html:
    """Text that is markup already."""

    text: str


Cell = Union[Html, str, float, int, None]


def picture(path: Path, page: Path, link: Optional[Path] = None) -> Html:
    """A picture, where there is one, that leads to `link`. Paths become relative to the page's folder."""
    if not path.exists():
        return Html("")
    image = f'<img loading="lazy" src="{_url(path, page)}" alt="">'
    return Html(f'<a href="{_url(link, page)}">{image}</a>' if link and link.exists() else image)


def listing(items: Iterable[str]) -> Html:
    """One item a line."""
    return Html("<br>".join(escape(item) for item in items))


def write(path: Path, title: str, introduction: str, heads: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
    """Writes a page with one sortable table."""
    own = files(__package__)
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "\n".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in rows)
    path.write_text(
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>\n'
        f"<style>\n{own.joinpath('page.css').read_text()}</style>\n"
        f"<h1>{escape(title)}</h1>\n<p>{escape(introduction)}</p>\n"
        f"<table><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table>\n"
        f"<script>\n{own.joinpath('page.js').read_text()}</script></html>\n"
    )


def _cell(value: Cell) -> str:
    if isinstance(value, Html):
        return f"<td>{value.text}</td>"
    if isinstance(value, (int, float)):
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        return f'<td class="number" data-value="{value}">{text}</td>'
    text = value or ""
    return f'<td class="{"failed" if text == "failed" else "text"}">{escape(text)}</td>'


def _url(path: Path, page: Path) -> str:
    try:
        return quote(str(path.relative_to(page.parent)))
    except ValueError:
        return path.resolve().as_uri()
