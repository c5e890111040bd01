"""What other programs recorded: numbers by column, and their times, out of text, NPZ, MAT, MCAP, WAV and FLAC."""

import csv
import io
import json
import math
import os
import re
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.decoder import DecoderFactory
from mcap.records import Chunk, Schema
from numpy.typing import NDArray

from controller.recording.mcap_file import LARGEST_CHUNK_BYTES, LIBRARY, ChunkPlace, records
from controller.scales import si_unit
from drivers.core.messages import Floats

LARGEST_BYTES = 2**31
"""A file that holds more is refused before it is read: 45 minutes of a channel at 96 kHz as text. Assumption."""

COMMENT = ("#", "%", "//")
"""What a line of a text file begins with that holds no numbers."""

SEPARATORS = ("\t", ";", ",")
"""Between two fields of a text file, the first that is found in a row of numbers; spaces where there is none."""

NAMED = 20
"""How many columns are named at once."""

PREAMBLE, PROOF = 500, 3
"""Lines above a table at the most, and rows of numbers alike that make one (assumptions)."""

LVM = "***End_of_Header***"
"""What ends a header of LabVIEW's text files; the columns' names follow the last."""

SCALES_S = {
    "s": 1.0,
    "sec": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "\u00b5s": 1e-6,
    "\u03bcs": 1e-6,
    "ns": 1e-9,
}
"""Seconds in a unit of time, as columns are named after them."""

SCALES_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6}
"""Metres in a unit of length, as columns are named after them; of the two letters a keyboard has one for micro."""

TIME = re.compile(
    rf"(?:t|time|timestamp|elapsed|x_value|zeit|temps|tiempo|tempo)(?:[ _]*[(\[]?({'|'.join(SCALES_S)})[)\]]?)?",
    re.IGNORECASE,
)
"""Names of a column of times; without a unit they are seconds, or those of a calendar clock."""

NUMBER, IS = r"\d[\d.,]*(?:e[-+]?\d+)?", r"""(?: is)?[\s:=,;"']+"""
HZ, S = r"k?hz|k?s/s|k?sps|samples/s|1/s", "|".join(SCALES_S)
AGAIN = r"(?!\w|\.\d| ?(?:baud|k?bit|bps|%))"
RATE = r"\b(?:sampl\w*|scan|data) (?:rate|freq\w*)|\babtast(?:rate|frequenz)|\bs(?:ample)?rate|^\W*rate|\bfs"
STATED = tuple(
    re.compile(each)
    for each in (
        rf"(?:{RATE})(?: ?[(\[]?(?:in )?(?P<hz>{HZ})[)\]]?)?{IS}(?P<number>{NUMBER}) ?(?P<also_hz>{HZ})?{AGAIN}",
        rf"\b(?:sampled|recorded|logged|acquired) (?:at|with) (?P<number>{NUMBER}) ?(?P<hz>{HZ})\b",
        rf"^\W*(?P<number>{NUMBER}) ?(?P<hz>{HZ})\W*$",
        rf"\b(?:sampl\w* (?:interval|period)|delta ?[tx]|dt)(?: ?[(\[]?(?P<step>{S})[)\]]?)?{IS}"
        rf"(?P<number>{NUMBER}) ?(?P<also_step>{S})?{AGAIN}",
    )
)
"""How a line above a table states the samples a second, or the time between two (LabVIEW's `Delta_X`): in lower case, a
space for each `_`."""

STATED_HZ = (1e-3, 1e9)
"""A line that states fewer or more samples a second states none (assumption)."""

CALENDAR = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3), (1e8, 1.0))
"""Times above the first number are counted since 1970 in units of so many seconds: each holds from 1973 to 5138."""

STEPS = (0.2, 1.8)
"""A step between two rows in this range of periods is one of a sampler that wanders; a longer one is a gap."""

NO_NAMES: Mapping[str, str] = {}

LEFT_OUT = "Reached EOF prematurely|Incomplete chunk|Length of header or names does not match"
"""What a library merely warns of where it leaves a part of the file out."""


class ReplayError(ValueError):
    """A recording cannot be used: one line with file, what is wrong and what to do."""


@dataclass(frozen=True)
class Chosen:
    """Some columns of a file.

    Attributes:
        name: Of the first column.
        values: Shape (n, columns); lengths in metres.
        unit: Of the first column, by its name; "" where that has none.
        times_s: Of each row, shape (n,); None where the file has none.
        rate_hz: Where the file itself gives it.
        clock: The source of the times, as text.
    """

    name: str
    values: Floats
    unit: str = ""
    times_s: Floats | None = None
    rate_hz: float | None = None
    clock: str = ""


def read_columns(path: Path, column: str | None, count: int = 1) -> Chosen:
    """Some columns of a file, side by side.

    Args:
        path: A file of one of the kinds in `READERS`.
        column: Names with commas between them; None is the only column there is besides the times. Columns of a WAV
            file are channels, from 0; of an array of two dimensions NAME.0, NAME.1 …; of an MCAP file TOPIC:FIELD.
            FIRST..LAST are columns in the file's order that hold consecutive samples of one, row by row.
        count: How many columns there must be where none are named.

    Raises:
        ReplayError: it is none of these, or does not hold what is asked for.
    """
    try:
        read = READERS.get(path.suffix.lower())
        if read is None:
            kinds = ", ".join(READERS)
            raise ReplayError(f"'{path.suffix}' is no recording; give a run folder or a file of {kinds}")
        if path.stat().st_size > LARGEST_BYTES:
            raise ReplayError(f"larger than {LARGEST_BYTES >> 30} GiB; cut it into pieces")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", message=LEFT_OUT)
            return read(path, column, count)
    except ReplayError as error:  # what is raised below has no path
        raise ReplayError(f"{path}: {error}") from None
    except OSError as error:
        raise ReplayError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # each library reports damaged files in its own ways
        kind = path.suffix.removeprefix(".").upper()
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ReplayError(f"{path}: no {kind} file of numbers that can be read: {reason}") from None


def _chosen(
    table: Mapping[str, NDArray[Any]], column: str | None, count: int, full: Mapping[str, str] = NO_NAMES
) -> Chosen:
    """The columns that are asked for and their times, out of a table; `full` are names with a unit from elsewhere."""
    clock = "t_s" if "t_s" in table else next((name for name in table if TIME.fullmatch(name)), None)
    names = [name for name in table if name != clock]
    if column and ".." in column and column not in table:
        return _unrolled(table, clock, names, column, full)
    wanted = column.split(",") if column else names
    listed = ", ".join([*names[:NAMED], *(["…"] if len(names) > NAMED else [])]) or "none besides the times"
    if not column and len(names) != count:
        raise ReplayError(
            f"which column? choose with --column; there are {listed}{_rising(table, names, clock)}"
        )
    for name in wanted:
        if name not in table:
            raise ReplayError(f"no column {name}; there are {listed}")
        if not len(table[name]):
            raise ReplayError(f"column {name} has no rows")
        if not np.issubdtype(table[name].dtype, np.number) or np.iscomplexobj(table[name]):
            raise ReplayError(f"column {name} {_odd(table[name])}, which is no number")
    lengths = {name: len(table[name]) for name in [*wanted, *([clock] if clock else [])]}
    other = next((name for name, length in lengths.items() if length != lengths[wanted[0]]), None)
    if other is not None:
        raise ReplayError(f"{wanted[0]} has {lengths[wanted[0]]} rows, {other} has {lengths[other]}")
    times_s, source = _times(clock, table, full)
    values = np.column_stack([table[name].astype(np.float64) for name in wanted])
    return _named(wanted, values, times_s, source, full)


def _named(
    names: Sequence[str],
    values: Floats,
    times_s: Floats | None,
    clock: str,
    full: Mapping[str, str] = NO_NAMES,
) -> Chosen:
    """Columns with the unit that the first one's name states, lengths scaled to metres."""
    units = [_unit(full.get(name, name)) for name in names]
    values *= [scale for _, scale in units]
    return Chosen(names[0], values, units[0][0], times_s, clock=clock)


def _unit(name: str) -> tuple[str, float]:
    """Unit of a column by its name, as in `way_mm`, `acc_z (m/s^2)` or `Force [N]`, and what its values are to be
    multiplied with."""
    name = re.sub(r"\.\d+$", "", name)  # a column of an array
    bracketed = re.search(r"[\[(]([^\[\]()]+)[\])]\s*$", name)
    if bracketed:
        scale = SCALES_M.get(bracketed[1].strip())
        return (bracketed[1], 1.0) if scale is None else ("m", scale)
    stem, _, last = name.lower().rpartition("_")
    scale = SCALES_M.get(last, 1.0)
    unit = si_unit(f"{stem}_m" if last in SCALES_M else name.lower())  # none of a torque, `_n_mm`
    return unit, scale if unit == "m" else 1.0


def _stated(chosen: Chosen, lines: Sequence[str]) -> Chosen:
    """The same with the sample rate that some lines state, where it has no times and no two of them differ."""
    stated = {_stated_hz(line): line.strip()[:60] for line in reversed(lines)}
    said = {rate_hz: line for rate_hz, line in stated.items() if STATED_HZ[0] <= rate_hz <= STATED_HZ[1]}
    if chosen.times_s is not None or len(said) != 1:
        return chosen
    ((rate_hz, line),) = said.items()
    return replace(chosen, rate_hz=rate_hz, clock=f"its line '{line}'")


def _stated_hz(line: str) -> float:
    """Samples a second that a line states; 0 where it states none."""
    text = line.lower().replace("_", " ")
    match = next((match for match in (each.search(text) for each in STATED) if match), None)
    if match is None:
        return 0.0
    found = {name: part for name, part in match.groupdict().items() if part}
    digits = found["number"].rstrip(".,")
    grouped = re.fullmatch(r"\d{1,3}(,\d{3})+(\.\d+)?", digits)
    plain = digits.replace(",", "" if grouped else ".")
    number = float(plain) if _numeric(plain) else 0.0  # a version, 1.2.3, is none
    if "step" in match.groupdict():
        step_s = number * SCALES_S[found.get("step") or found.get("also_step") or "s"]
        return float(f"{1.0 / step_s:.9g}") if step_s else 0.0
    return number * (1e3 if (found.get("hz") or found.get("also_hz") or "").startswith("k") else 1.0)


def _unrolled(
    table: Mapping[str, NDArray[Any]],
    clock: str | None,
    names: Sequence[str],
    column: str,
    full: Mapping[str, str],
) -> Chosen:
    """Columns that hold consecutive samples, as one; a row's time is that of its first sample."""
    ends = column.split("..")
    if len(ends) != 2 or any(end not in names for end in ends):
        raise ReplayError(f"no columns {column}; FIRST..LAST are two of {', '.join(names[:NAMED])}")
    wanted = names[names.index(ends[0]) : names.index(ends[1]) + 1]
    if not wanted:
        raise ReplayError(f"{ends[1]} stands before {ends[0]}; turn them round")
    rows = _chosen(table, ",".join(wanted), len(wanted), full)
    times_s, many = rows.times_s, len(wanted)
    if times_s is not None and len(times_s) > 1:
        steps_s = np.diff(times_s, append=2.0 * times_s[-1] - times_s[-2])
        usual_s = float(np.median(steps_s))
        steps_s[steps_s > STEPS[1] * usual_s] = usual_s  # a row before a gap is as long as the others
        times_s = (times_s[:, None] + steps_s[:, None] * np.arange(many) / many).ravel()
    return Chosen(ends[0], rows.values.reshape(-1, 1), rows.unit, times_s, clock=rows.clock)


def _rising(table: Mapping[str, NDArray[Any]], names: Sequence[str], clock: str | None) -> str:
    """What is said of the first column that may have the times, where none is named after them: a count of samples
    would give a rate of 1,000 Hz as milliseconds."""
    for name, cells in ((name, table[name]) for name in names if clock is None):
        if np.issubdtype(cells.dtype, np.number) and len(cells) > 2 and (np.diff(cells) > 0).all():
            counts = (np.diff(cells) == 1).all()
            how = "counts the samples: give --rate HZ; or, if these are" if counts else "rises: if it has the"
            named = ",".join("t_ms" if each == name else each for each in names[:NAMED])
            return f"; {name} {how} times, write as the first line {named}"
    return ""


def _odd(cells: NDArray[Any]) -> str:
    """What a column holds that is no number, and in which row; its first cell where each could be one."""
    row = next((row for row, cell in enumerate(cells) if not _numeric(str(cell))), 0)
    cell = cells[row]
    return f"holds {cell.item() if isinstance(cell, np.generic) else cell!r} in row {row + 1}"


def _times(
    clock: str | None, table: Mapping[str, NDArray[Any]], full: Mapping[str, str]
) -> tuple[Floats | None, str]:
    """Times in seconds, and where they come from."""
    if clock is None:
        return None, ""
    times, unit = table[clock], TIME.fullmatch(full.get(clock, clock))
    if not np.issubdtype(times.dtype, np.number):
        return _calendar_dates(clock, times), f"{clock}, a date, from its first row on"
    if unit is None and clock in full:
        raise ReplayError(
            f"column {full[clock]}: no unit of times that is known; give it in s, ms, us or ns, or mark the line of"
            " units with #"
        )
    first = float(times[0]) if len(times) else 0.0
    scale_s = SCALES_S[unit[1].lower()] if unit and unit[1] else None
    if scale_s is None:
        scale_s = next((scale_s for least, scale_s in CALENDAR if first >= least), 1.0)
    if first * scale_s >= CALENDAR[-1][0]:
        # as whole numbers first: a float of nanoseconds since 1970 knows 256 ns
        return (times - times[0]).astype(np.float64) * scale_s, f"{clock}, from its first row on"
    return times.astype(np.float64) * scale_s, clock


def _calendar_dates(clock: str, times: NDArray[Any]) -> Floats:
    import pandas as pd

    if not len(times):
        return np.empty(0)
    dates = pd.to_datetime(pd.Series(times), utc=True, format="ISO8601", errors="coerce")
    if dates.isna().any():
        row = int(np.flatnonzero(dates.isna())[0])
        odd = _odd(times) if _numeric(str(times[0])) else f"holds {times[row]!r} in row {row + 1}"
        raise ReplayError(f"column {clock} {odd}, which is no time")
    since_s: Floats = (dates - dates.iloc[0]).dt.total_seconds().to_numpy(np.float64)
    return since_s


# --- text ----------------------------------------------------------------------------------------


def _read_text(path: Path, column: str | None, count: int) -> Chosen:
    """One line of names, or a comment with them, or none; then rows of numbers, with whatever stands between them."""
    import pandas as pd

    try:
        text = path.read_text("utf-8-sig")
    except UnicodeDecodeError:
        text = path.read_text("latin-1")  # any bytes; as older loggers write degrees and umlauts
    odd = re.search(r"[\0-\x08\x0e-\x1f\x7f-\x9f]", text)
    if odd:
        raise ReplayError(f"byte {odd.start()}: no text; is it another kind of file?")
    lines = [line for line in text.splitlines() if line.strip()]
    rows: Sequence[str] = [line for line in lines if not line.lstrip().startswith(COMMENT)]
    if not rows:
        raise ReplayError("has no rows")
    rows, units = _below_preamble(rows)
    begin = lines.index(rows[0]) if rows[0] in lines else 0
    comment = lines[begin - 1].lstrip() if begin else ""
    marked = comment.lstrip("#%/ \t") if comment.startswith(COMMENT) else ""
    names, body, separator = _header(rows, marked)
    twice = next((name for place, name in enumerate(names) if name in names[:place]), None)
    if twice is not None:
        raise ReplayError(f"two columns are called '{twice}' in the first line; rename one")
    if not names:
        raise ReplayError("has no columns")
    if body and (fields := len(_fields(body[0], separator))) != len(names):
        raise ReplayError(
            f"no table of numbers under one line of names: {len(names)} names ({', '.join(names[:NAMED])}), but"
            f" {fields} fields in the row below; name each column, or mark that line with #"
        )
    if separator:  # what a program wrote between two rows
        body = [row for row in body if row.count(separator) == body[0].count(separator) or not _wordy(row)]
    comma = separator != "," and any(
        "," in field and _numeric(field) for row in body if "," in row for field in _fields(row, separator)
    )
    try:
        table = pd.read_csv(
            io.StringIO("\n".join(body)),
            sep=separator or r"\s+",
            names=names,
            header=None,
            index_col=False,
            decimal="," if comma else ".",
            skipinitialspace=True,
            low_memory=False,
        )
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:
        reason = str(error).splitlines()[0]
        raise ReplayError(f"no table of numbers under one line of names: {reason}") from None
    full = {
        name: f"{name} [{unit}]"
        for name, unit in zip(names, units, strict=False)
        if unit and not _unit(name)[0] and not ((time := TIME.fullmatch(name)) and time[1])
    }
    chosen = _chosen({name: table[name].to_numpy() for name in names}, column, count, full)
    ends = (" ,;\t", body[0].strip(" ,;\t") if body else "")
    above = next((n for n, line in enumerate(lines) if line.strip(ends[0]) == ends[1]), 0)
    return _stated(chosen, lines[:above])


def _below_preamble(rows: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """The table, with its line of names if it has one, without the unmarked lines that a program wrote above it; and
    the units that stand in a line below the names.

    Raises:
        ReplayError: no rows of numbers begin; the first line that was not understood is named.
    """
    if any(row.strip().startswith(LVM) for row in rows):
        return _labview(rows), ()
    if len(rows) <= PROOF:
        return rows, ()
    first, *others = [len(_fields(row, _separator(rows[1]))) for row in rows[: 1 + PROOF]]
    if first == len(_split(rows[1])) <= min(others) and not _wordy(rows[1]):
        return rows, ()
    for place in range(min(PREAMBLE, len(rows) - PROOF + 1)):
        proof = [_split(row) for row in rows[place : place + PROOF]]
        counts = {len(fields) for fields in proof}
        if len({(len(fields), sum(map(_numeric, fields))) for fields in proof}) > 1 or _wordy(rows[place]):
            continue
        # names stand next above, or above a line of units and one of scales
        above = rows[max(0, place - 3) : place]
        same = [row for row in above if _separator(row) == _separator(rows[place])]
        words = [row for row in same if {len(_split(row))} == counts and _wordy(row)]
        header = words[0] if words else None
        if header is None and same[-1:] == above[-1:] and _amiss(above[-1:], len(proof[0])):
            header = above[-1]
        units = [unit.strip("()[] -") for unit in _split(words[1])] if words[1:] else []
        return ([header] if header else []) + list(rows[place:]), units
    odd = next((row for row in rows[1:] if _wordy(row)), rows[0])
    if any(map(_numeric, _split(odd))):
        return rows, ()  # dates or words beside numbers: a table
    raise ReplayError(
        f"no table of numbers: the first line that was not understood is '{odd.strip()[:60]}'; mark what stands"
        " above the table with #"
    )


def _labview(rows: Sequence[str]) -> Sequence[str]:
    """The names and rows of a file of LabVIEW's, of all its segments where each has a header of its own.

    Raises:
        ReplayError: it has no rows, or segments that make no one table.
    """
    marks = [place for place, row in enumerate(rows) if row.strip().startswith(LVM)]
    marks = marks[1:] or marks  # the first ends the file's own header
    names = {rows[mark + 1] for mark in marks if mark + 1 < len(rows)}
    if not names:
        raise ReplayError("has no rows")
    cells = [row.rstrip("\t").split("\t") for row in rows[marks[0] + 2 :]]
    cells = [
        row for row in cells if _numeric(row[0])
    ]  # the next segment's header begins each line with a word
    timeless = not any(row[0] for row in cells)  # X_Columns No
    if len(names) > 1 or (timeless and len(marks) > 1):
        what = "columns of other names each" if len(names) > 1 else "no times"
        raise ReplayError(f"{len(marks)} segments with {what}; save each as a file of its own")
    fields = slice(1 if timeless and cells else 0, len(cells[0]) if cells else None)  # "Comment" has no cells
    return ["\t".join(row[fields]) for row in (names.pop().split("\t"), *cells)]


def _amiss(above: Sequence[str], columns: int) -> bool:
    """Whether the line above a table has single words for one column more or less than there are."""
    names = _split(above[0]) if above and _separator(above[0]) and _wordy(above[0]) else []
    return len(names) > 1 and abs(len(names) - columns) == 1 and all(len(name.split()) == 1 for name in names)


def _separator(row: str) -> str:
    separator = next((one for one in SEPARATORS if one in row), "")
    # with decimal commas alone, between numbers with spaces between them
    spaced = all(map(_numeric, row.split())) and not all(map(_numeric, _fields(row, ",")))
    return "" if separator == "," and spaced else separator


def _split(row: str) -> list[str]:
    return _fields(row.rstrip(" ,;\t"), _separator(row))


def _wordy(row: str) -> bool:
    """Whether a line holds no number."""
    return not any(field and _numeric(field) for field in _split(row))


def _header(rows: Sequence[str], comment: str) -> tuple[list[str], Sequence[str], str]:
    """Names of the columns, the rows of numbers, and what stands between two fields ("" for spaces)."""
    separator = _separator(rows[1] if len(rows) > 1 else rows[0])
    first, second = _fields(rows[0], separator), _fields(rows[1], separator) if len(rows) > 1 else []
    # a label in each row makes no line of names
    labelled = any(map(_numeric, first)) and list(map(_numeric, first)) == list(map(_numeric, second))
    if not all(map(_numeric, first)) and not labelled:
        names, rows = first, rows[1:]
    else:
        named = _fields(comment, separator)
        names = named if len(named) == len(first) else [str(place) for place in range(len(first))]
    while names and not names[-1]:
        names.pop()
    if rows and separator and len(_fields(rows[0], separator)) == len(names) + 1:
        rows = [row.rstrip().removesuffix(separator) for row in rows]  # a separator after each last field
    return names, rows, separator


def _fields(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    return [field.strip() for field in next(csv.reader([line], delimiter=separator))]


def _numeric(field: str) -> bool:
    try:
        float(field.replace(",", ".") or "nan")
    except ValueError:
        return False
    return True


# --- arrays --------------------------------------------------------------------------------------


def _read_npz(path: Path, column: str | None, count: int) -> Chosen:
    with ZipFile(path) as packed:
        if sum(part.file_size for part in packed.infolist()) > LARGEST_BYTES:
            raise ReplayError(f"unpacks to more than {LARGEST_BYTES >> 30} GiB; cut it into pieces")
        for part in packed.infolist():
            _check_npy(packed, part)
    with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
        arrays = {name: np.asarray(file[name]) for name in file.files}
    return _of_arrays(arrays, column, count)


def _check_npy(packed: ZipFile, part: ZipInfo) -> None:
    """Refuse an array that is larger by its header than there are bytes: room would be made for all of it."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with packed.open(part) as opened:
        version = np.lib.format.read_magic(opened)
        if version not in headers:
            raise ValueError(f"{part.filename} is of version {version}")
        shape, _, dtype = headers[version](opened)
    if math.prod(shape) * dtype.itemsize > part.file_size:
        raise ValueError(f"{part.filename} has {part.file_size} bytes, no {shape} of {dtype}")


def _read_mat(path: Path, column: str | None, count: int) -> Chosen:
    from scipy.io import loadmat

    try:
        loaded = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise ReplayError("a MAT file of version 7.3; save it with -v7") from None
    return _of_arrays(dict(_arrays(loaded)), column, count)


def _arrays(loaded: Mapping[str, Any], within: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Arrays of a MAT file and of the structures in it, by names with dots."""
    for name, found in loaded.items():
        if isinstance(found, Mapping):
            yield from _arrays(found, f"{within}{name}.")
        elif isinstance(found, np.ndarray | float | int):
            yield f"{within}{name}", np.squeeze(found)


def _of_arrays(arrays: Mapping[str, NDArray[Any]], column: str | None, count: int) -> Chosen:
    """Arrays of one dimension are columns; one of two has them side by side along its shorter one."""
    table: dict[str, NDArray[Any]] = {}
    for name, array in arrays.items():
        if array.ndim == 1:
            table[name] = array
        elif array.ndim == 2:
            tall = array if array.shape[0] >= array.shape[1] else array.T
            table |= {f"{name}.{place}": tall[:, place] for place in range(tall.shape[1])}
    said = [f"{name} = {array}" for name, array in arrays.items() if not array.ndim]
    if not table:
        raise ReplayError(f"no array of one or two dimensions; it has {', '.join(arrays) or 'nothing'}")
    return _stated(_chosen(table, column, count), said)


def _read_wav(path: Path, column: str | None, count: int) -> Chosen:
    """Channels in full-scale units (-1 to 1), and the sample rate."""
    from scipy.io import wavfile

    _check_riff(path)
    rate_hz, samples = wavfile.read(path)
    full = 1.0
    if samples.dtype == np.uint8:  # 8-bit WAV is unsigned, silence is 128
        samples, full = samples.astype(np.float64) - 128.0, 128.0
    elif np.issubdtype(samples.dtype, np.integer):
        full = float(np.iinfo(samples.dtype).max + 1)
    return _sound(samples if samples.ndim == 2 else samples[:, None], full, rate_hz, column, count)


def _read_flac(path: Path, column: str | None, count: int) -> Chosen:
    """As a WAV file."""
    try:
        import soundfile
    except (ImportError, OSError) as error:
        raise ReplayError(f"FLAC takes soundfile: install the extra 'sound' ({error})") from None
    samples, rate_hz = soundfile.read(path, always_2d=True)
    return _sound(samples, 1.0, rate_hz, column, count)


def _sound(samples: NDArray[Any], full: float, rate_hz: float, column: str | None, count: int) -> Chosen:
    """Channels of sound, as shares of full scale."""
    if column is None and samples.shape[1] != count:
        raise ReplayError(f"{samples.shape[1]} channels; choose one with --column 0")
    numbers = channel_numbers("", column or "0", samples.shape[1])
    values = samples[:, numbers].astype(np.float64) / full
    return Chosen(f"channel {column or 0}", values, rate_hz=float(rate_hz), clock="the file itself")


def _check_riff(path: Path) -> None:
    """Refuse a file with a piece that is longer by its header than there are bytes: room would be made for it."""
    size, offset = path.stat().st_size, 12
    with path.open("rb") as file:
        large = file.read(4) == b"RF64"
        while offset + 8 <= size:
            file.seek(offset)
            name, length = struct.unpack("<4sI", file.read(8))
            if name == b"ds64" and large:
                sound_bytes = int.from_bytes(file.read(16)[8:], "little")
                if sound_bytes > size:
                    raise ValueError(f"it is cut off: its header claims {sound_bytes} bytes of sound")
            elif length == 0xFFFFFFFF and large:
                return
            elif length > size - offset - 8:
                raise ValueError(f"it is cut off: a piece at byte {offset} claims {length} bytes")
            offset += 8 + length + length % 2


def channel_numbers(where: str, column: str, count: int) -> list[int]:
    """Numbers of channels as they are written on the command line.

    Raises:
        ReplayError: there is no such channel.
    """
    numbers = column.split(",")
    unknown = next((each for each in numbers if not (each.isdecimal() and int(each) < count)), None)
    if unknown is not None:
        raise ReplayError(f"{where}no channel {unknown}; there are 0 to {count - 1}")
    return [int(each) for each in numbers]


# --- MCAP of other programs ----------------------------------------------------------------------


class _Json(DecoderFactory):
    """Messages in JSON, beside the MCAP library's own decoders of protobuf and ROS 2."""

    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], Any] | None:
        return json.loads if message_encoding == "json" else None


def _read_mcap(path: Path, column: str | None, count: int) -> Chosen:
    """Fields of one topic, TOPIC:FIELD[,FIELD]; a field within a field has a dot, an item of a list its number."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    topic, _, named = (column or "").partition(":")
    fields = named.split(",")
    rows: list[list[float | None]] = []
    clocks: list[tuple[int, int | None]] = []
    _check_chunks(path)
    with _Bounded(io.FileIO(path)) as file:
        reader = make_reader(file, decoder_factories=[_Json(), Protobuf(), Ros2()])
        if reader.get_header().library == LIBRARY:
            raise ReplayError(
                "the recording of a run, whose samples for plotting are thinned out; give its folder"
            )
        summary = reader.get_summary()
        topics = sorted({channel.topic for channel in summary.channels.values()}) if summary else []
        if not named or (topics and topic not in topics):
            raise ReplayError(
                f"which field of which topic? choose with --column TOPIC:FIELD; topics are"
                f" {', '.join(topics) or 'not listed in it'}"
            )
        begin_ns = summary.statistics.message_start_time if summary and summary.statistics else None
        for _, _, message, decoded in reader.iter_decoded_messages(topics=[topic]):
            row = [_field(decoded, field) for field in fields]
            missing = [field for field, value in zip(fields, row, strict=True) if value is None]
            if missing:
                raise ReplayError(f"{topic} has no number {missing[0]}")
            rows.append(row)
            clocks.append((message.log_time, _stamp_ns(decoded)))
    if not rows:
        raise ReplayError(f"{topic} has no message")
    stamped = all(stamp for _, stamp in clocks)
    anchor_ns = clocks[0][0] - (clocks[0][0] if begin_ns is None else begin_ns)
    first_log_ns, first_stamp_ns = clocks[0]
    since_ns = [stamp - first_stamp_ns if stamped else log - first_log_ns for log, stamp in clocks]  # type: ignore[operator]
    times_s: Floats = (np.array(since_ns, np.int64) + anchor_ns).astype(np.float64) * 1e-9
    clock = "header.stamp" if stamped else "log_time"
    return _named(fields, np.array(rows, np.float64), times_s, clock)


class _Bounded(io.BufferedReader):
    """A file of which no read is longer than the whole, whatever length a record claims."""

    def read(self, size: int | None = -1) -> bytes:
        """See `io.BufferedReader.read`."""
        return super().read(min(size, os.fstat(self.fileno()).st_size) if size else size)


def _check_chunks(path: Path) -> None:
    """Refuse a file with a chunk that unpacks to more than any recorder writes: the MCAP library would unpack it."""
    import zstandard

    with path.open("rb") as file:
        for body, length in (record for record in records(path) if isinstance(record, ChunkPlace)):
            file.seek(body)
            chunk = Chunk.read(ReadDataStream(io.BytesIO(file.read(length))))
            unpacked = chunk.uncompressed_size
            if chunk.compression == "zstd":
                claimed = zstandard.get_frame_parameters(chunk.data).content_size
                unpacked = max(unpacked, 0 if claimed == zstandard.CONTENTSIZE_UNKNOWN else claimed)
            if unpacked > LARGEST_CHUNK_BYTES:
                raise ValueError(f"the chunk at byte {body} unpacks to {unpacked} bytes")


def _field(message: Any, field: str) -> float | None:
    """A field of a message; None where there is none, or no number in it."""
    for part in field.split("."):
        if isinstance(message, Mapping):
            message = message.get(part)
        elif part.isdecimal() and isinstance(message, Sequence):
            message = message[int(part)] if int(part) < len(message) else None
        else:
            message = getattr(message, part, None)
    number = isinstance(message, int | float) and not isinstance(message, bool)
    return float(message) if number else None


def _stamp_ns(message: Any) -> int | None:
    """Time stamp in a ROS header, or None."""
    for names in (("sec", "nanosec"), ("secs", "nsecs")):  # ROS 2, and ROS 1 in JSON
        seconds, rest = (_field(message, f"header.stamp.{name}") for name in names)
        if seconds is not None:
            return int(seconds) * 1_000_000_000 + int(rest or 0)
    return None


READERS: Mapping[str, Callable[[Path, str | None, int], Chosen]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".lvm", ".log"), _read_text),
    ".npz": _read_npz,
    ".mat": _read_mat,
    ".wav": _read_wav,
    ".flac": _read_flac,
    ".mcap": _read_mcap,
}
"""By the end of a file's name."""
