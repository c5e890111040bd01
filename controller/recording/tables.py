"""What other programs recorded: numbers by column, and their times, out of text, NPZ, MAT, MCAP, WAV and FLAC."""

import csv
import io
import json
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile, ZipInfo

import numpy as np
from mcap.records import Channel, Footer, Header, Schema
from numpy.typing import NDArray

from controller.recording.mcap_file import LIBRARY, messages, records, topics
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


class ReadTable(NamedTuple):
    """What a file holds.

    Attributes:
        columns: By name, in the file's order; each of shape (n,).
        full: Names with the unit that stands elsewhere, by column.
        said: Lines that may state the sample rate.
        times_s: Of each row, where no column has them.
        rate_hz: Where it is no line that gives it.
        clock: The source of both.
        full_scale: What the values are shares of.
    """

    columns: Mapping[str, NDArray[Any]]
    full: Mapping[str, str] = {}
    said: Sequence[str] = ()
    times_s: Floats | None = None
    rate_hz: float | None = None
    clock: str = ""
    full_scale: float = 1.0


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
            return _chosen(read(path, column), column, count)
    except ReplayError as error:  # what is raised below has no path
        raise ReplayError(f"{path}: {error}") from None
    except OSError as error:
        raise ReplayError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # each library reports damaged files in its own ways
        kind = path.suffix.removeprefix(".").upper()
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ReplayError(f"{path}: no {kind} file of numbers that can be read: {reason}") from None


def _chosen(table: ReadTable, column: str | None, count: int) -> Chosen:
    """The columns that are asked for, and their times."""
    columns = table.columns
    clock = "t_s" if "t_s" in columns else next((name for name in columns if TIME.fullmatch(name)), None)
    if table.times_s is not None:
        clock = None
    names = [name for name in columns if name != clock]
    listed = ", ".join([*names[:NAMED], *(["…"] if len(names) > NAMED else [])]) or "none besides the times"
    if not column and len(names) != count:
        timeless = "" if clock or table.clock else "; times are in one called t_s, t_ms, time …, and none is"
        raise ReplayError(f"which column? choose with --column; there are {listed}{timeless}")
    wanted = names if not column else [column] if column in columns else column.split(",")
    rolled = len(wanted) == 1 and ".." in wanted[0] and column not in columns
    if rolled:
        first, _, last = wanted[0].partition("..")
        wanted = names[names.index(first) : names.index(last) + 1] if {first, last} <= {*names} else []
        if not wanted:
            raise ReplayError(f"no columns {column}; FIRST..LAST are two of {listed}, in this order")
    for name in wanted:
        if name not in columns:
            raise ReplayError(f"no column {name}; there are {listed}")
        if not len(columns[name]):
            raise ReplayError(f"column {name} has no rows")
        if not np.issubdtype(columns[name].dtype, np.number) or np.iscomplexobj(columns[name]):
            raise ReplayError(f"column {name} {_odd(columns[name])}, which is no number")
    lengths = {name: len(columns[name]) for name in [*wanted, *([clock] if clock else [])]}
    other = next((name for name, length in lengths.items() if length != lengths[wanted[0]]), None)
    if other is not None:
        raise ReplayError(f"{wanted[0]} has {lengths[wanted[0]]} rows, {other} has {lengths[other]}")
    times_s, rate_hz, source = table.times_s, table.rate_hz, table.clock
    if clock is not None:
        times_s, source = _times(clock, columns[clock], table.full)
    elif not source:
        rate_hz, source = _stated(table.said)
    units = [_unit(table.full.get(name, name)) for name in wanted]
    values = np.column_stack([columns[name].astype(np.float64) for name in wanted]) / table.full_scale
    values *= [scale for _, scale in units]
    if rolled:
        values, times_s = values.reshape(-1, 1), times_s if times_s is None else _spread(times_s, len(wanted))
    return Chosen(wanted[0], values, units[0][0], times_s, rate_hz, source)


def _spread(times_s: Floats, many: int) -> Floats:
    """Times of so many samples a row, of which the first has the row's."""
    if len(times_s) < 2:
        return times_s
    steps_s = np.diff(times_s, append=2.0 * times_s[-1] - times_s[-2])
    usual_s = float(np.median(steps_s))
    steps_s[steps_s > STEPS[1] * usual_s] = usual_s  # a row before a gap is as long as the others
    return (times_s[:, None] + steps_s[:, None] * np.arange(many) / many).ravel()


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


def _stated(lines: Sequence[str]) -> tuple[float | None, str]:
    """The sample rate that some lines state, where no two of them differ, and which line it is."""
    stated = {_stated_hz(line): line.strip()[:60] for line in reversed(lines)}
    said = {rate_hz: line for rate_hz, line in stated.items() if STATED_HZ[0] <= rate_hz <= STATED_HZ[1]}
    if len(said) != 1:
        return None, ""
    ((rate_hz, line),) = said.items()
    return rate_hz, f"its line '{line}'"


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


def _odd(cells: NDArray[Any]) -> str:
    """What a column holds that is no number, and in which row; its first cell where each could be one."""
    row = next((row for row, cell in enumerate(cells) if not _numeric(str(cell))), 0)
    cell = cells[row]
    return f"holds {cell.item() if isinstance(cell, np.generic) else cell!r} in row {row + 1}"


def _times(clock: str, times: NDArray[Any], full: Mapping[str, str]) -> tuple[Floats, str]:
    """Times in seconds, and where they come from."""
    unit = TIME.fullmatch(full.get(clock, clock))
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


Laid = tuple[list[str], list[str], Sequence[str], str]
"""Of a table in text: names of its columns, units below them, rows of numbers, what stands between two fields ("" for
spaces)."""


def _read_text(path: Path, column: str | None) -> ReadTable:
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
    marks = [place for place, row in enumerate(rows) if row.strip().startswith(LVM)]
    names, units, rows, separator = _labview(rows, marks) if marks else _laid(rows, lines)
    twice = next((name for place, name in enumerate(names) if name in names[:place]), None)
    if twice is not None:
        raise ReplayError(f"two columns are called '{twice}' in the first line; rename one")
    if rows and (fields := len(_fields(rows[0], separator))) != len(names):
        raise ReplayError(
            f"no table of numbers under one line of names: {len(names)} names ({', '.join(names[:NAMED])}), but"
            f" {fields} fields in the row below; name each column, or mark that line with #"
        )
    if separator:  # what a program wrote between two rows
        rows = [row for row in rows if row.count(separator) == rows[0].count(separator) or not _wordy(row)]
    comma = separator != "," and any(
        "," in field and _numeric(field) for row in rows if "," in row for field in _fields(row, separator)
    )
    try:
        table = pd.read_csv(
            io.StringIO("\n".join(rows)),
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
    ends = (" ,;\t", rows[0].strip(" ,;\t") if rows else "")
    above = next((n for n, line in enumerate(lines) if line.strip(ends[0]) == ends[1]), 0)
    return ReadTable({name: table[name].to_numpy() for name in names}, full, lines[:above])


def _laid(rows: Sequence[str], lines: Sequence[str]) -> Laid:
    """The table among a file's rows; its names may stand in a comment, which is among its `lines` alone."""
    header, units, begin = _begins(rows)
    body = rows[begin:]
    separator = _separator(body[0] if body else header)
    if header:
        names = _fields(header, separator)
    else:
        ended = bool(separator) and all(row.rstrip(" ").endswith(separator) for row in body)
        width, above = len(_fields(body[0], separator)) - ended, lines[: lines.index(body[0])][-1:]
        comments = [line.lstrip() for line in above if line.lstrip().startswith(COMMENT)]
        named = [_fields(comment.lstrip("#%/ \t"), separator) for comment in comments]
        names = named[0] if [*map(len, named)] == [width] else [str(place) for place in range(width)]
    while names and not names[-1]:
        names.pop()
    if body and separator and len(_fields(body[0], separator)) == len(names) + 1:
        body = [row.rstrip().removesuffix(separator) for row in body]  # a separator after each last field
    return names, [unit.strip("()[] -") for unit in _split(units)], body, separator


def _begins(rows: Sequence[str]) -> tuple[str, str, int]:
    """The line of names and that of units ("" where there is none), and the row at which numbers begin.

    Raises:
        ReplayError: none begin; the first line that was not understood is named.
    """
    kinds = [tuple(map(_numeric, _fields(row, _separator(row)))) for row in rows[: PREAMBLE + PROOF]]
    counts = [len(_fields(row, _separator(rows[:2][-1]))) for row in rows[: 1 + PROOF]]
    if len(rows) == 1 or (counts[0] == len(_split(rows[1])) <= min(counts) and not _wordy(rows[1])):
        named = not all(kinds[0]) and kinds[0] not in kinds[1:2]  # a label in each row makes no line of names
        return (rows[0], "", 1) if named else ("", "", 0)
    for begin in range(len(kinds)):
        proof = {(len(kind), sum(kind)) for kind in kinds[begin : begin + PROOF]}
        if len(proof) > 1 or _wordy(rows[begin]):
            continue
        # names stand next above, or above a line of units and one of scales
        separator, widths = _separator(rows[begin]), {len(kinds[begin]), len(_split(rows[begin]))}
        above = [row for row in rows[max(0, begin - 3) : begin] if _separator(row) == separator]
        words = [row for row in above if len(_split(row)) in widths and _wordy(row)]
        if not words and separator and above and above[-1] is rows[begin - 1] and _wordy(above[-1]):
            fields = _split(above[-1])  # single words, for one column more or less than there are
            single = len(fields) > 1 and all(len(name.split()) == 1 for name in fields)
            words = above[-1:] if single and abs(len(fields) - min(widths)) == 1 else []
        if not begin or begin + PROOF <= len(rows) or words[-1:] == rows[begin - 1 : begin]:
            header, units = [*words, "", ""][:2]
            return header, units, begin
    odd = next((row for row in rows[1:] if _wordy(row)), rows[0])
    raise ReplayError(
        f"no table of numbers: the first line that was not understood is '{odd.strip()[:60]}'; mark what stands"
        " above the table with #"
    )


def _labview(rows: Sequence[str], marks: Sequence[int]) -> Laid:
    """The table of a file of LabVIEW's, of all its segments where each has a header of its own; `marks` end headers.

    Raises:
        ReplayError: it has no rows, or segments that make no one table.
    """
    marks = marks[1:] or marks  # the first ends the file's own header
    names = {rows[mark + 1] for mark in marks if mark + 1 < len(rows)}
    if not names:
        raise ReplayError("has no rows")
    cells = [row.rstrip("\t").split("\t") for row in rows[marks[0] + 2 :]]
    cells = [row for row in cells if _numeric(row[0])]  # a word begins each line of the next segment's header
    timeless = not any(row[0] for row in cells)  # X_Columns No
    if len(names) > 1 or (timeless and len(marks) > 1):
        what = "columns of other names each" if len(names) > 1 else "no times"
        raise ReplayError(f"{len(marks)} segments with {what}; save each as a file of its own")
    fields = slice(1 if timeless and cells else 0, len(cells[0]) if cells else None)  # "Comment" has no cells
    body = ["\t".join(row[fields]) for row in cells]
    return names.pop().split("\t")[fields], [], body, "\t"


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


def _read_npz(path: Path, column: str | None) -> ReadTable:
    with ZipFile(path) as packed:
        if sum(part.file_size for part in packed.infolist()) > LARGEST_BYTES:
            raise ReplayError(f"unpacks to more than {LARGEST_BYTES >> 30} GiB; cut it into pieces")
        for part in packed.infolist():
            _check_npy(packed, part)
    with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
        arrays = {name: np.asarray(file[name]) for name in file.files}
    return _of_arrays(arrays)


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


def _read_mat(path: Path, column: str | None) -> ReadTable:
    from scipy.io import loadmat

    try:
        loaded = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise ReplayError("a MAT file of version 7.3; save it with -v7") from None
    return _of_arrays(dict(_arrays(loaded)))


def _arrays(loaded: Mapping[str, Any], within: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Arrays of a MAT file and of the structures in it, by names with dots."""
    for name, found in loaded.items():
        if isinstance(found, Mapping):
            yield from _arrays(found, f"{within}{name}.")
        elif isinstance(found, np.ndarray | float | int):
            yield f"{within}{name}", np.squeeze(found)


def _of_arrays(arrays: Mapping[str, NDArray[Any]]) -> ReadTable:
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
    return ReadTable(table, said=said)


def _read_wav(path: Path, column: str | None) -> ReadTable:
    """Channels in full-scale units (-1 to 1), and the sample rate."""
    from scipy.io import wavfile

    # out of memory: of a file room would be made for all that a header claims
    rate_hz, samples = wavfile.read(io.BytesIO(path.read_bytes()))
    full_scale = 1.0
    if samples.dtype == np.uint8:  # 8-bit WAV is unsigned, silence is 128
        samples, full_scale = samples.astype(np.float64) - 128.0, 128.0
    elif np.issubdtype(samples.dtype, np.integer):
        full_scale = float(np.iinfo(samples.dtype).max + 1)
    return _sound(samples if samples.ndim == 2 else samples[:, None], rate_hz, full_scale)


def _read_flac(path: Path, column: str | None) -> ReadTable:
    """As a WAV file."""
    try:
        import soundfile
    except (ImportError, OSError) as error:
        raise ReplayError(f"FLAC takes soundfile: install the extra 'sound' ({error})") from None
    return _sound(*soundfile.read(path, always_2d=True))


def _sound(samples: NDArray[Any], rate_hz: float, full_scale: float = 1.0) -> ReadTable:
    channels = {str(number): samples[:, number] for number in range(samples.shape[1])}
    return ReadTable(channels, rate_hz=float(rate_hz), clock="the file itself", full_scale=full_scale)


# --- MCAP of other programs ----------------------------------------------------------------------


def _read_mcap(path: Path, column: str | None) -> ReadTable:
    """Fields of one topic, TOPIC:FIELD[,FIELD]; a field within a field has a dot, an item of a list its number."""
    asked = (column or "").split(",")
    topic, _, first = asked[0].partition(":")
    fields = [first, *asked[1:]]
    header, known = next(records(path), None), topics(path)
    if isinstance(header, Header) and header.library == LIBRARY:
        raise ReplayError(
            "the recording of a run, whose samples for plotting are thinned out; give its folder"
        )
    decode = {number: _decoder(*each) for number, each in known.items() if each[0].topic == topic}
    if not first or not decode:
        listed = ", ".join(sorted({channel.topic for channel, _ in known.values()})) or "none"
        raise ReplayError(
            f"which field of which topic? choose with --column TOPIC:FIELD; topics are {listed}"
        )
    rows: list[tuple[int, int | None, list[float | None]]] = []
    begin_ns, whole = 2**64, False
    for record in records(path):
        whole = isinstance(record, Footer)
        for number, _, log_ns, data in messages(path, record):
            begin_ns = min(begin_ns, log_ns)
            if number in decode:
                decoded = decode[number](data)
                row = [_field(decoded, field) for field in fields]
                if None in row:
                    raise ReplayError(f"{topic} has no number {fields[row.index(None)]}")
                rows.append((log_ns, _stamp_ns(decoded), row))
    if not whole:
        raise ReplayError("it is cut off; close it with the program that wrote it")
    if not rows:
        raise ReplayError(f"{topic} has no message")
    rows.sort(key=lambda row: row[0])
    stamped = all(stamp for _, stamp, _ in rows)
    since_ns = [(stamp if stamped and stamp else log_ns) for log_ns, stamp, _ in rows]
    after_ns = rows[0][0] - begin_ns - since_ns[0]
    times_s = np.array([each + after_ns for each in since_ns], np.int64).astype(np.float64) * 1e-9
    columns = dict(zip(asked, np.array([row for *_, row in rows], np.float64).T, strict=True))
    return ReadTable(columns, times_s=times_s, clock="header.stamp" if stamped else "log_time")


def _decoder(channel: Channel, schema: Schema | None) -> Callable[[bytes], Any]:
    """What reads a channel's messages: JSON, protobuf or ROS 2."""
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    if channel.message_encoding == "json":
        return json.loads
    for factory in (Protobuf(), Ros2()):
        if decode := factory.decoder_for(channel.message_encoding, schema):
            return decode
    raise ReplayError(f"{channel.topic}: messages in '{channel.message_encoding}' are not read")


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


READERS: Mapping[str, Callable[[Path, str | None], ReadTable]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".lvm", ".log"), _read_text),
    ".npz": _read_npz,
    ".mat": _read_mat,
    ".wav": _read_wav,
    ".flac": _read_flac,
    ".mcap": _read_mcap,
}
"""By the end of a file's name."""
