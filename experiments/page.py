"""What an experiment writes: tables as Markdown and as one csv, text, pictures."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxalign.tables import Estimate, markdown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Page", "Table"]


@dataclass
class Table:
    """Rows of cells: text, numbers, or numbers with standard errors.

    Attributes:
        name: in the csv file.
        columns: headings; those of numbers name the unit.
        rows: of as many cells.
    """

    name: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]] = field(default_factory=list)

    def add(self, *cells: Any) -> None:
        """One more row."""
        if len(cells) != len(self.columns):
            raise ValueError(f"{len(cells)} cells for {len(self.columns)} columns of {self.name}")
        self.rows.append(cells)

    def markdown(self) -> str:
        """As a Markdown table."""
        return markdown(self.columns, [[_text(x) for x in cells] for cells in self.rows])

    def records(self) -> list[tuple[Any, ...]]:
        """(table, row, column, value, standard error) of each number; the words of a row name it."""
        out = []
        for cells in self.rows:
            row = "; ".join(x for x in cells if isinstance(x, str) and x)
            for column, cell in zip(self.columns, cells, strict=True):
                if isinstance(cell, Estimate):
                    out.append((self.name, row, column, f"{cell.value:.6g}", f"{cell.error:.3g}"))
                elif not isinstance(cell, str):
                    out.append((self.name, row, column, f"{cell:.6g}", ""))
        return out


def _text(cell: Any) -> str:
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)


@dataclass
class Page:
    """Text with tables in it, and pictures.

    Attributes:
        parts: paragraphs and tables, in order.
        pictures: file name without its ending -> figure.
    """

    parts: list[str | Table] = field(default_factory=list)
    pictures: dict[str, Figure] = field(default_factory=dict)

    def add(self, *parts: str | Table) -> None:
        """More paragraphs and tables."""
        self.parts += parts

    def picture(self, name: str, caption: str, figure: Figure) -> None:
        """A picture with its caption."""
        self.pictures[name] = figure
        self.add(f"![{caption}]({name}.png)")

    def write(self, folder: Path) -> list[Path]:
        """results.md, results.csv and the pictures.

        Returns:
            The files.
        """
        folder.mkdir(parents=True, exist_ok=True)
        text, numbers = folder / "results.md", folder / "results.csv"
        parts = [part.markdown() if isinstance(part, Table) else part for part in self.parts]
        text.write_text("\n\n".join(parts) + "\n")
        with numbers.open("w", newline="") as file:
            out = csv.writer(file, lineterminator="\n")
            out.writerow(("table", "row", "column", "value", "standard error"))
            for table in self.parts:
                if isinstance(table, Table):
                    out.writerows(table.records())
        files = [text, numbers]
        for name, figure in self.pictures.items():
            files.append(folder / f"{name}.png")
            save(figure, files[-1])
        return files


def save(figure: Figure, path: Path) -> None:
    """As a png of 128 colours: a third of the size."""
    from PIL import Image

    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())  # pyright: ignore[reportAttributeAccessIssue]
    Image.fromarray(pixels).convert("RGB").quantize(128).save(path, optimize=True)
