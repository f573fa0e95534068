"""Exports a recording as one episode of a LeRobot data set, format v3.0."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.exports.files import POSE_COLUMNS, NewPlace, contact_numbers, touch_numbers
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import U8, Reconstruction
from tacshade_edge.version import how_to_install

IMAGE, HEIGHT, CONTACT = "observation.images.tactile", "observation.tactile.height_mm", "observation.tactile.contact"
TOUCH, TOUCH_SIGMA = "observation.tactile.touch", "observation.tactile.touch_sigma"
TIME, STATE = "observation.tactile.t_s", "observation.state"
CONTACT_NAMES: Final = (
    *("contact", "depth_max_mm", "area_mm2", "volume_mm3", "objects", "x_mm", "y_mm"),
    *("shear_x_mm", "shear_y_mm", "twist_deg"),
)
TASK: Final = "touch"
_INDICES: Final = ("frame_index", "episode_index", "index", "task_index")
_ROWS_PER_GROUP: Final = 64  # held in memory until they are written
_DATA, _EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"


class LeRobotExport:
    """A folder that LeRobot's loader reads; recordings.md lists the features. Needs the extra ``lerobot``.

    Raises ConfigError without it; so does `add` if an image differs in size, or only some frames have poses.
    """

    def __init__(self, folder: Path, touch_names: Sequence[str]) -> None:
        try:
            import pyarrow
            import pyarrow.parquet  # sets the attribute pyarrow.parquet
        except ImportError as error:
            found = f"found no package {error.name}, which LeRobot's format needs"
            raise ConfigError(f"{found}; to install it: {how_to_install('lerobot')}") from None
        self._pa: Any = pyarrow
        self._place = NewPlace(folder)
        self._writer: Any = None
        self._touch_names = touch_names
        self._features: dict[str, dict[str, Any]] = {}
        self._stats: dict[str, _Spread] = {}
        self._rows: list[dict[str, Any]] = []
        self._times_ns: list[int] = []
        self._first_ns = self._frames = self._fps = 0
        with self._place.writing():
            for name in (_DATA, _EPISODES):
                (self._place.partial / name).parent.mkdir(parents=True)

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Add a frame; 64 are written at once."""
        frame, name = recorded.frame, recorded.name
        image = frame.image if frame.image.ndim == 3 else np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR))
        self._first_ns = self._first_ns or frame.t_ns
        numbers = contact_numbers(recorded, result)
        touch, touch_sigma = touch_numbers(result, self._touch_names)
        row: dict[str, Any] = {
            HEIGHT: np.nan_to_num(result.height.height_mm),
            CONTACT: np.array([numbers[key] or 0.0 for key in CONTACT_NAMES], np.float32),
            TOUCH: np.array([value or 0.0 for value in touch], np.float32),
            TOUCH_SIGMA: np.array([value or 0.0 for value in touch_sigma], np.float32),
            TIME: np.array([(frame.t_ns - self._first_ns) / 1e9], np.float32),
        }
        if frame.pose is not None:
            row[STATE] = np.array([getattr(frame.pose, key) for key in POSE_COLUMNS], np.float32)
        if not self._features:
            self._features = _features(image, row, self._touch_names)
        if self._features[IMAGE]["shape"] != list(image.shape):
            raise ConfigError(
                f"{name}: found the size {image.shape[1]}x{image.shape[0]} px, expected the first image's size"
            )
        if (STATE in self._features) != (STATE in row):
            found, expected = ("a pose", "none") if STATE in row else ("no pose", "one")
            raise ConfigError(
                f"{name}: found {found}, expected {expected}, as in the first frame; "
                "LeRobot needs poses in all frames or in none"
            )
        for key, value in row.items():
            self._stats.setdefault(key, _Spread()).add(value[None])
        self._stats.setdefault(IMAGE, _Spread()).add(image[:, :, ::-1].reshape(-1, 3) / 255.0)
        _, png = cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 1))
        self._rows.append({IMAGE: {"bytes": png.tobytes(), "path": None}, **row})
        self._times_ns.append(frame.t_ns)
        if len(self._rows) == _ROWS_PER_GROUP:
            self._write_rows()

    def finish(self) -> None:
        """Complete the data set and move it to its final name. Raises ConfigError if there was no frame."""
        if not self._features:
            raise ConfigError(f"{self._place.path}: found no frame, expected at least one")
        self._write_rows()
        with self._place.writing():
            self._writer.close()
            self._write_meta()
        self._place.take()

    def discard(self) -> None:
        """Remove the unfinished folder."""
        if self._writer is not None:
            self._writer.close()
        self._place.discard()

    def _write_rows(self) -> None:
        pa, rows = self._pa, self._rows
        if not rows:
            return
        self._fps = self._fps or _rate(self._times_ns)
        index = np.arange(self._frames, self._frames + len(rows))
        values: dict[str, Any] = {key: np.stack([row[key] for row in rows]) for key in rows[0] if key != IMAGE}
        values["timestamp"] = (index / self._fps).astype(np.float32)
        values |= {"frame_index": index, "index": index}
        values |= {key: np.zeros(len(rows), np.int64) for key in ("episode_index", "task_index")}
        for key in ("timestamp", *_INDICES):
            self._stats.setdefault(key, _Spread()).add(values[key][:, None])
        image_type = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        columns = {IMAGE: pa.array([row[IMAGE] for row in rows], image_type)}
        columns |= {key: _column(pa, value) for key, value in values.items()}
        # Without it, loading this file alone gives images as pairs of bytes and a path.
        described = json.dumps({"info": {"features": {key: _arrow_feature(self._features[key]) for key in columns}}})
        table = pa.table(columns).replace_schema_metadata({"huggingface": described})
        with self._place.writing():
            if self._writer is None:
                self._writer = pa.parquet.ParquetWriter(self._place.partial / _DATA, table.schema)
            self._writer.write_table(table)
        self._frames += len(rows)
        self._rows, self._times_ns = [], []

    def _write_meta(self) -> None:
        pa, meta, frames = self._pa, self._place.partial / "meta", self._frames
        info = {
            "codebase_version": "v3.0",
            "robot_type": "tacshade",
            "total_episodes": 1,
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 500,
            "fps": self._fps,
            "splits": {"train": "0:1"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": self._features,
        }
        stats = {key: spread.summary(frames, per_pixel=key == IMAGE) for key, spread in self._stats.items()}
        for name, document in (("info.json", info), ("stats.json", stats)):
            (meta / name).write_text(json.dumps(document, indent=4) + "\n", encoding="utf-8")
        # LeRobot looks up a task by its name, in the form in which pandas stores an index.
        column = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"}
        index = {"name": None, "field_name": "__index_level_0__", "pandas_type": "unicode", "numpy_type": "object"}
        columns = [{**described, "metadata": None} for described in (column, index)]
        pandas = {"index_columns": ["__index_level_0__"], "column_indexes": [], "columns": columns}
        tasks = pa.table({"task_index": pa.array([0], pa.int64()), "__index_level_0__": pa.array([TASK])})
        pa.parquet.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(pandas)}), meta / "tasks.parquet")
        episode: dict[str, Any] = {
            "episode_index": 0,
            "tasks": [TASK],
            "length": frames,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": 0,
            "dataset_to_index": frames,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for key, summary in stats.items():
            episode |= {f"stats/{key}/{name}": value for name, value in summary.items()}
        pa.parquet.write_table(pa.Table.from_pylist([episode]), self._place.partial / _EPISODES)


class _Spread:
    """The minimum, maximum, mean and standard deviation along the first axis of data that arrives in parts."""

    def __init__(self) -> None:
        self._count = 0
        self._least: Any = np.inf
        self._greatest: Any = -np.inf
        self._mean: Any = 0.0
        self._squares: Any = 0.0

    def add(self, values: npt.NDArray[np.generic]) -> None:
        """Add values (n, ...) by Chan, Golub and LeVeque's update, which keeps its precision for large means."""
        part = values.astype(np.float64)
        count, mean = len(part), part.mean(axis=0)
        total, apart = self._count + count, mean - self._mean
        self._squares = self._squares + ((part - mean) ** 2).sum(axis=0) + apart**2 * (self._count * count / total)
        self._mean, self._count = self._mean + apart * (count / total), total
        self._least, self._greatest = np.minimum(self._least, part.min(axis=0)), np.maximum(self._greatest, part.max(0))

    def summary(self, frames: int, *, per_pixel: bool) -> dict[str, Any]:
        """The statistics in LeRobot's form; for an image one value per channel, of shape (3, 1, 1)."""
        std = np.sqrt(self._squares / self._count)
        found = {"min": self._least, "max": self._greatest, "mean": self._mean, "std": std}
        shaped = {key: value.reshape(3, 1, 1) if per_pixel else value for key, value in found.items()}
        return {key: value.tolist() for key, value in shaped.items()} | {"count": [frames]}


def _features(image: U8, row: dict[str, Any], touch_names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """LeRobot's description of the features, with a name for each value that has one."""
    named = {CONTACT: list(CONTACT_NAMES), STATE: list(POSE_COLUMNS), TIME: None, HEIGHT: ["row", "col"]}
    named |= {key: list(touch_names) for key in (TOUCH, TOUCH_SIGMA)}
    features: dict[str, dict[str, Any]] = {}
    features[IMAGE] = {"dtype": "image", "shape": list(image.shape), "names": ["height", "width", "channels"]}
    features |= {key: {"dtype": "float32", "shape": list(row[key].shape), "names": named[key]} for key in row}
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    return features | {key: {"dtype": "int64", "shape": [1], "names": None} for key in _INDICES}


def _arrow_feature(feature: dict[str, Any]) -> dict[str, Any]:
    """A feature as described by the library `datasets`, with which LeRobot reads Parquet."""
    shape, value = feature["shape"], {"dtype": feature["dtype"], "_type": "Value"}
    if feature["dtype"] == "image":
        return {"_type": "Image"}
    if len(shape) == 2:
        return {"shape": shape, "dtype": feature["dtype"], "_type": "Array2D"}
    return value if shape == [1] else {"feature": value, "length": shape[0], "_type": "Sequence"}


def _rate(times_ns: list[int]) -> int:
    """The median frame rate in frames per second, rounded to an integer, as LeRobot expects."""
    return max(1, round(1e9 / float(np.median(np.diff(times_ns))))) if len(times_ns) > 1 else 1


def _column(pa: Any, values: npt.NDArray[np.generic]) -> Any:
    """An Arrow column: arrays (n,) and (n, 1) become numbers, (n, a) lists, (n, a, b) lists of lists."""
    column = pa.array(values.ravel())
    for size in reversed(values.shape[1:] if values.shape[1:] != (1,) else ()):
        column = pa.FixedSizeListArray.from_arrays(column, size)
    lists = values.ndim - 1 if values.shape[1:] != (1,) else 0
    kind = pa.from_numpy_dtype(values.dtype)
    for _ in range(lists):
        kind = pa.list_(kind)
    return column.cast(kind)
