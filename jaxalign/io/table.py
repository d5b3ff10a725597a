"""Text tables with a header line: named columns as numbers, fast, and an exact place for what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxalign.arguments import nearest
from jaxalign.errors import UserError
from jaxalign.files import existing_file, first_line, read_text

__all__ = ["Table"]


class Table:
    """A CSV file: separator comma, semicolon, tab or blanks; `#` starts a comment; blank lines are skipped.

    Attributes:
        path: the file.
        header: names of the columns; a `#` before the header line is allowed.
        lines: line number in the file (counted from 1) of every row.
    """

    def __init__(self, path: Path):
        """Splits the file into header and rows.

        Raises:
            UserError: no file, no header, no rows, or a row that is longer than the header.
        """
        self.path = existing_file(path)
        head = ""
        self._rows: list[str] = []
        numbers: list[int] = []
        for number, line in enumerate(read_text(self.path).splitlines(), start=1):
            if not line or line.isspace():
                continue
            if line.startswith("#"):
                if not self._rows:
                    head = line
                continue
            self._rows.append(line)
            numbers.append(number)
        if not self._rows:
            raise UserError(f"{self.path}: no rows in the file")
        first = self._rows[0]
        self._separator = next((c for c in ("\t", ";", ",") if c in first), None)
        if all(_is_number(cell) for cell in self._split(first)):
            if len(self._split(head.lstrip("# "))) != len(self._split(first)):
                raise UserError(
                    f"{self.path}: line {numbers[0]} is numbers: a header line with the column names is expected"
                )
        else:
            head = first
            del self._rows[0], numbers[0]
            if not self._rows:
                raise UserError(f"{self.path}: no rows after the header")
        self.header = self._split(head.lstrip("# "))
        self.lines = np.array(numbers)
        self._refuse_long_rows()

    def numbers(self, names: Sequence[str], blank: bool = False) -> np.ndarray:
        """Columns by name.

        Args:
            names: K column names.
            blank: whether an empty cell is a missing value (NaN) rather than an error.

        Returns:
            (N, K) float64.

        Raises:
            UserError: a column is not there or twice; a cell is not a number.
        """
        where = [self._find(name) for name in names]
        converters = {column: _blank_or_number for column in where} if blank else None
        try:
            return np.loadtxt(
                self._rows,
                delimiter=self._separator,
                usecols=where,
                converters=converters,  # type: ignore[arg-type]
                comments=None,
                quotechar='"',
                ndmin=2,
            )
        except ValueError as error:
            self._explain(where, blank)
            raise UserError(f"{self.path}: cannot be read as a table: {first_line(error)}") from None

    def _find(self, name: str) -> int:
        count = self.header.count(name)
        if count == 0:
            raise UserError(f"{self.path}: no column {name!r}: {nearest(name, self.header)}")
        if count > 1:
            raise UserError(f"{self.path}: the column {name!r} is there {count} times: rename them")
        return self.header.index(name)

    def _split(self, line: str) -> list[str]:
        return [cell.strip().strip('"').strip() for cell in line.split(self._separator)]

    def _refuse_long_rows(self) -> None:
        """A row with more cells than the header (a decimal comma?) would shift its columns unseen."""
        width = len(self.header)
        for number, line in zip(self.lines, self._rows, strict=True):
            separators = line.count(self._separator) if self._separator else len(line.split()) - 1
            if separators >= width and '"' not in line and any(self._split(line)[width:]):
                raise UserError(
                    f"{self.path}: line {number} has {separators + 1} cells, the header {width}: "
                    "decimal commas, or a header that does not belong?"
                )

    def _explain(self, where: Sequence[int], blank: bool) -> None:
        """Finds the first bad cell, the slow way."""
        for number, line in zip(self.lines, self._rows, strict=True):
            cells = self._split(line)
            if len(cells) <= max(where):
                raise UserError(
                    f"{self.path}: line {number} has {len(cells)} cells, the header {len(self.header)}: "
                    "complete or remove it"
                ) from None
            for column in where:
                cell = cells[column]
                if not _is_number(cell) and not (blank and not cell):
                    raise UserError(
                        f"{self.path}: line {number}, column {self.header[column]!r}: {cell!r} is not a number"
                    ) from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _blank_or_number(cell: str) -> float:
    return float(cell) if cell and not cell.isspace() else np.nan
