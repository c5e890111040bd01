"""A run in the formats of other programs: tables in CSV or Parquet, a LeRobot dataset, samples as a bag of ROS 2."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from controller.measures import columns_of
from controller.recording.reader import Run
from controller.recording.run_folder import RunFolderError, writing
from controller.scales import si_unit
from drivers.core.errors import lacking

if TYPE_CHECKING:
    import pandas as pd
    from mcap_ros2.writer import Writer

Message = dict[str, Any]

_PARTS: Mapping[str, Sequence[str]] = {
    "std_msgs/Header": ("builtin_interfaces/Time stamp", "string frame_id"),
    "builtin_interfaces/Time": ("int32 sec", "uint32 nanosec"),
    "geometry_msgs/Vector3": ("float64 x", "float64 y", "float64 z"),
    "geometry_msgs/Wrench": ("geometry_msgs/Vector3 force", "geometry_msgs/Vector3 torque"),
    "geometry_msgs/Quaternion": ("float64 x", "float64 y", "float64 z", "float64 w"),
}
"""What messages are made of."""


def _definition(fields: str, *parts: str) -> str:
    """The text of a message that begins with a header."""
    own = "\n".join(["std_msgs/Header header", *fields.split(", ")])
    parts = ("std_msgs/Header", "builtin_interfaces/Time", *parts)
    named = ("\n".join(["=" * 80, f"MSG: {name}", *_PARTS[name]]) for name in parts)
    return "\n".join([own, "", *named, ""])


DEFINITIONS: Mapping[str, str] = {
    "geometry_msgs/msg/WrenchStamped": _definition(
        "geometry_msgs/Wrench wrench", "geometry_msgs/Vector3", "geometry_msgs/Wrench"
    ),
    "sensor_msgs/msg/JointState": _definition(
        "string[] name, float64[] position, float64[] velocity, float64[] effort"
    ),
    "sensor_msgs/msg/Imu": _definition(
        "geometry_msgs/Quaternion orientation, float64[9] orientation_covariance, "
        "geometry_msgs/Vector3 angular_velocity, float64[9] angular_velocity_covariance, "
        "geometry_msgs/Vector3 linear_acceleration, float64[9] linear_acceleration_covariance",
        "geometry_msgs/Vector3",
        "geometry_msgs/Quaternion",
    ),
}
"""Messages of ROS 2 as common_interfaces defines them (Humble; the same in later ones)."""


def export(run: Run, to: str, out: Path) -> list[Path]:
    """Write a run into a folder in another format.

    Args:
        out: The folder; made where it is not there.

    Returns:
        The files that were written.

    Raises:
        RunFolderError: what the format needs is not installed, or the recording is damaged.
        RecordingError: the files cannot be written.
    """
    try:
        with writing(out, option="--into"):
            out.mkdir(parents=True, exist_ok=True)
            return FORMATS[to](run, out)
    except ImportError as error:
        raise RunFolderError(f"--to {to}: {'; '.join(lacking(error.name or to, 'parquet'))}") from None


def tidy(run: Run) -> Path | None:
    """Write trials.parquet beside a run's trials.csv: the same rows and columns, each with its unit and meaning; None
    where pyarrow is not installed.

    Raises:
        RecordingError: it cannot be written.
    """
    if find_spec("pyarrow") is None:
        return None
    path = run.folder.path / "trials.parquet"
    with writing(path, option=""):
        return _trials_parquet(run, path)


def _trials_parquet(run: Run, path: Path) -> Path:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyarrow.csv import ConvertOptions, read_csv  # arrays of Python's own values would load pandas, 0.2 s

    meanings = columns_of(run.manifest.get("experiment"))
    names = list(dict.fromkeys(["trial", "outcome", *(name for row in run.trials for name in row)]))
    text = io.StringIO(newline="")
    lines = csv.writer(text)
    lines.writerow(names)
    lines.writerows([row.get(name) for name in names] for row in run.trials)
    kinds = {name: _kind([row.get(name) for row in run.trials]) for name in names}
    how = ConvertOptions(column_types=kinds, null_values=[""], strings_can_be_null=True)
    table = read_csv(io.BytesIO(text.getvalue().encode()), convert_options=how)
    fields = []
    for field in table.schema:
        said = {"unit": si_unit(field.name), "meaning": meanings.get(field.name, "")}
        fields.append(field.with_metadata({key: text for key, text in said.items() if text}))
    pq.write_table(table.cast(pa.schema(fields)), path, compression="zstd")
    return path


def _kind(values: Sequence[Any]) -> str:
    """Arrow's type of a column: text where it is mixed."""
    kinds = {type(value) for value in values if value is not None}
    if not kinds:
        return "null"
    if kinds <= {int, float}:
        return "double" if float in kinds else "int64"
    return "bool" if kinds == {bool} else "string"


def samples(run: Run, trial: int) -> pd.DataFrame:
    """A trial's samples, tidy: columns trial, stream, channel, t_s (bench time, s), value (in `unit`), unit."""
    import pandas as pd

    recording = run.trial(trial)
    frames = []
    for name in recording.streams:
        series = recording.stream(name)
        for channel in range(series.values.shape[1]):
            table = {"t_s": series.times_s, "value": series.values[:, channel]}
            frames.append(pd.DataFrame(table).assign(stream=name, channel=channel, unit=series.unit))
    columns = ["trial", "stream", "channel", "t_s", "value", "unit"]
    if not frames:
        return pd.DataFrame(columns=columns)
    return pd.concat(frames, ignore_index=True).assign(trial=trial)[columns]


def _csv(run: Run, out: Path) -> list[Path]:
    paths = [out / "trials.csv"]
    run.table.to_csv(paths[0], index=False)
    for trial in run.recorded_trials:
        paths.append(out / f"samples_{trial}.csv")
        samples(run, trial).to_csv(paths[-1], index=False)
    return paths


def _parquet(run: Run, out: Path) -> list[Path]:
    """trials.parquet and samples.parquet, a row group a trial: memory holds one trial."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    paths = [out / "trials.parquet", out / "samples.parquet"]
    _trials_parquet(run, paths[0])
    fields = {"trial": pa.int64(), "stream": pa.string(), "channel": pa.int64()}
    schema = pa.schema({**fields, "t_s": pa.float64(), "value": pa.float64(), "unit": pa.string()})
    with pq.ParquetWriter(paths[1], schema, compression="zstd") as writer:
        for trial in run.recorded_trials:
            writer.write_table(pa.Table.from_pandas(samples(run, trial), schema, preserve_index=False))
    return paths


def _rosbag2(run: Run, out: Path) -> list[Path]:
    """One bag a trial; a header's stamp is bench time."""
    from mcap_ros2.writer import Writer

    paths = []
    for trial in run.recorded_trials:
        paths.append(out / f"trial_{trial}.mcap")
        with paths[-1].open("wb") as file:
            writer = Writer(file)
            _write_bag(run, trial, writer)
            writer.finish()
    return paths


def _write_bag(run: Run, trial: int, writer: Writer) -> None:
    recording = run.trial(trial)
    schemas = {name: writer.register_msgdef(name, text) for name, text in DEFINITIONS.items()}
    for name in recording.streams:
        series = recording.stream(name)
        # what stands beside other quantities (a threshold, a tangential force, a second sensor) is no vector
        vector = series.values.shape[1] in (1, 3) or (series.unit == "N" and series.values.shape[1] == 6)
        kind, message = _ROS.get(series.unit if vector else "", _ROS[""])
        for number, (t_s, values) in enumerate(zip(series.times_s, series.values, strict=True)):
            t_ns = round(float(t_s) * 1e9)
            stamp = {"sec": t_ns // 1_000_000_000, "nanosec": t_ns % 1_000_000_000}
            header = {"stamp": stamp, "frame_id": name}
            content = {"header": header, **message(name, [float(v) for v in values])}
            writer.write_message(f"/{name.replace('.', '/')}", schemas[kind], content, t_ns, t_ns, number)


def _vector(values: list[float]) -> Message:
    return dict(zip("xyz", [*values, 0.0, 0.0, 0.0][:3], strict=True))


_NONE = {"x": 0.0, "y": 0.0, "z": 0.0}


def _wrench(name: str, values: list[float]) -> Message:
    """One channel is along x, three are a force; six are a wrench."""
    return {"wrench": {"force": _vector(values[:3]), "torque": _vector(values[3:6])}}


def _imu(name: str, values: list[float]) -> Message:
    unknown = [-1.0, *[0.0] * 8]  # REP 145: no estimate
    return {
        "orientation": {**_NONE, "w": 1.0},
        "orientation_covariance": unknown,
        "angular_velocity": _NONE,
        "angular_velocity_covariance": unknown,
        "linear_acceleration": _vector(values),
        "linear_acceleration_covariance": [0.0] * 9,
    }


def _joint(name: str, values: list[float]) -> Message:
    names = [name] if len(values) == 1 else [f"{name}.{channel}" for channel in range(len(values))]
    return {"name": names, "position": values, "velocity": [], "effort": []}


_ROS: Mapping[str, tuple[str, Callable[[str, list[float]], Message]]] = {
    "N": ("geometry_msgs/msg/WrenchStamped", _wrench),
    "m/s2": ("sensor_msgs/msg/Imu", _imu),
    "": ("sensor_msgs/msg/JointState", _joint),
}
"""By a stream's unit: its message, and how it is filled; what has none of its own goes as positions by name."""


def _lerobot(run: Run, out: Path) -> list[Path]:
    from controller.lerobot import write_lerobot

    return write_lerobot(run, out)


FORMATS: Mapping[str, Callable[[Run, Path], list[Path]]] = {
    "csv": _csv,
    "lerobot": _lerobot,
    "parquet": _parquet,
    "rosbag2": _rosbag2,
}
"""What `export --to` knows."""
