"""CSV files whose rows state which picture: `frame`, or a photograph's `file`."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from contract.errors import InputError
from ground.commands.values import file_name, frame_number

T = TypeVar("T")
Made = Callable[[dict[str, str], int | str, int], T]
PICTURE = ("frame", "file")  # the column that states which: one of them


def read_picture_rows(
    path: Path, columns: tuple[str, ...], made: Made[T], hint: str, most: int | None = None
) -> list[T]:
    """All rows, checked before the first is used, each as `made` of its cells, its picture and its number from 1.

    `hint` ends the message on a missing column. Raises InputError with the line's number.
    """
    out: list[T] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = csv.DictReader(stream, skipinitialspace=True, strict=True)
            header = rows.fieldnames or ()
            which = next((name for name in PICTURE if name in header), None)
            missing = [*([] if which else ["frame or file"]), *(name for name in columns if name not in header)]
            if which is None or missing:
                raise InputError(f"{path}, line 1: no column {', '.join(missing)}; {hint}")
            for row in rows:
                if most is not None and len(out) >= most:
                    raise InputError(f"{path}: more than {most} rows")
                cells = {name: cell or "" for name, cell in row.items() if name is not None}
                try:
                    picture = frame_number(cells[which]) if which == "frame" else file_name(cells[which])
                    out.append(made(cells, picture, len(out) + 1))
                except (ValueError, InputError, argparse.ArgumentTypeError) as error:
                    raise InputError(f"{path}, line {rows.line_num}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a CSV file ({error})") from error
    return out
