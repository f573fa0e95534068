"""PRESSES.csv: known presses, for ``tacshade-edge calibrate``;
and presses as a person or a plan states them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.files.tables import Rows, number, read_columns
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import named_file
from tacshade_edge.types import U8

BALL = "ball"
"""The indenter without an entry in INDENTERS.yaml."""

HEADER = ("image", "indenter", "radius_mm", "depth_mm", "x_mm", "y_mm")
MORE = ("yaw_deg", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm")
"""Optional columns; an empty cell means 0."""

_MOST_DEG = {"yaw_deg": 360.0, "tilt_x_deg": 60.0, "tilt_y_deg": 60.0}


@dataclass(frozen=True, slots=True)
class Stated:
    """A press as a person states it: the columns of PRESSES.csv except the image, as text."""

    columns: tuple[str, ...]

    def row(self) -> dict[str, str]:
        """The cells by column."""
        return dict(zip_longest((*HEADER[1:], *MORE), self.columns, fillvalue=""))

    def __str__(self) -> str:
        indenter, radius_mm, depth_mm, x_mm, y_mm, *more = self.columns
        size = f" of {radius_mm} mm" if radius_mm else ""
        place = f" at x {x_mm}, y {y_mm} mm" if x_mm else ""
        rest = "".join(f", {name} {text}" for name, text in zip(MORE, more, strict=False) if text)
        return f"{indenter}{size}, {depth_mm} mm deep{place}{rest}"


def read_presses(
    path: Path, indenters: Mapping[str, Indenter | float] | None = None
) -> tuple[list[KnownPress], tuple[str, ...]]:
    """Read the table and its images (relative to it), and notes on it for a person;
    `indenters` are INDENTERS.yaml's.

    Raises ConfigError for all mistakes (``FILE:LINE: column: found …, expected …``).
    """
    rows, notes = press_rows(path)
    presses, mistakes = list[KnownPress](), list[str]()
    for where, row in rows:
        try:
            # All mistakes at once: a table typed by hand has several.
            presses.append(_press(path, where, row, indenters or {}))
        except ConfigError as error:
            mistakes.append(str(error))
    if mistakes:
        raise ConfigError(mistakes[0], others=mistakes[1:])
    return presses, notes


def press_rows(path: Path) -> tuple[Rows, tuple[str, ...]]:
    """The rows, and notes for a person.

    Raises ConfigError if the table is absent or not such a table.
    """
    rows, unknown = read_columns(path, HEADER, MORE, "presses")
    names = ", ".join(shown(name or "one without a name", 40) for name in unknown[:10])
    return rows, (f"{path}: ignoring unknown columns: {names}",) if unknown else ()


def read_plan(path: Path, names: Collection[str], skin_radius_mm: float) -> tuple[Stated, ...]:
    """Read a plan of presses from a table like PRESSES.csv; its images are ignored.

    Raises ConfigError.
    """
    rows, _ = press_rows(path)
    if not rows:
        raise ConfigError(f"{path}: found no press, expected at least one")
    return tuple(stated(where, stated_columns(row), names, skin_radius_mm) for where, row in rows)


def stated_columns(row: Mapping[str, str]) -> tuple[str, ...]:
    """The cells of `Stated`, without the columns of `MORE` if all of those are empty."""
    more = tuple(row[name] for name in MORE)
    return (*(row[name] for name in HEADER[1:]), *(more if any(more) else ()))


def stated(
    where: str, columns: Sequence[str], names: Collection[str], skin_radius_mm: float
) -> Stated:
    """Check a press's ``indenter, radius_mm, depth_mm, x_mm, y_mm`` and either all columns of
    `MORE` or none; `names` are indenters in addition to the ball.

    Raises ConfigError.
    """
    press = Stated(tuple(columns))
    row, skin = press.row(), f"the skin's radius of {skin_radius_mm:g} mm"
    values = _checked(where, row, names)
    if row["indenter"] == BALL and not values["radius_mm"] > 0:
        raise ConfigError(
            f"{where}: radius_mm: found {row['radius_mm']}, expected a number above 0"
        )
    if not 0 < values["depth_mm"] < skin_radius_mm:
        raise ConfigError(
            f"{where}: depth_mm: found {row['depth_mm']}, "
            f"expected a number above 0 and below {skin}"
        )
    if row["x_mm"] and not values["x_mm"] ** 2 + values["y_mm"] ** 2 < skin_radius_mm**2:
        found = f"found {row['x_mm']}, {row['y_mm']} mm"
        raise ConfigError(f"{where}: x_mm, y_mm: {found}, expected a place within {skin}")
    return press


def _checked(where: str, row: Mapping[str, str], names: Collection[str]) -> dict[str, float]:
    """The numbers of a row's cells that are filled or must be. Raises ConfigError."""
    name = row["indenter"]
    if name != BALL and name not in names:
        others = ", ".join(sorted(names)) or "none without --indenters"
        raise ConfigError(
            f"{where}: indenter: found {quoted(name)}, expected {BALL} or one of INDENTERS.yaml: "
            f"{others}"
        )
    if name != BALL and row["radius_mm"]:
        found = f"found {quoted(row['radius_mm'])}"
        raise ConfigError(
            f"{where}: radius_mm: {found}, expected nothing, "
            "because INDENTERS.yaml states the radius"
        )
    if (row["x_mm"] == "") != (row["y_mm"] == ""):
        raise ConfigError(f"{where}: x_mm, y_mm: found only one value, expected both or neither")
    needed = ("depth_mm", *["radius_mm"] * (name == BALL))
    filled = (column for column in ("x_mm", "y_mm", *MORE) if row[column])
    values = {column: number(where, column, row[column]) for column in (*needed, *filled)}
    for column, most in _MOST_DEG.items():
        if abs(values.get(column, 0.0)) > most:
            found = f"found {quoted(row[column])}"
            raise ConfigError(
                f"{where}: {column}: {found}, expected a number from -{most:g} to {most:g}"
            )
    return values


def _press(
    path: Path, where: str, row: dict[str, str], indenters: Mapping[str, Indenter | float]
) -> KnownPress:
    try:
        image = read_image(named_file(path.parent, row["image"]))
    except DecodeError as error:
        raise ConfigError(f"{where}: image: {error}") from None
    return known_press(where, image, row, indenters)


def known_press(
    where: str, image: U8, row: Mapping[str, str], indenters: Mapping[str, Indenter | float]
) -> KnownPress:
    """The press of a row and its image.

    Raises ConfigError (``WHERE: column: found …, expected …``).
    """
    values = _checked(where, row, indenters)
    indenter = indenters.get(row["indenter"], values.get("radius_mm", 0.0))
    solid = indenter if isinstance(indenter, Indenter) else None
    if solid and "x_mm" not in values:
        raise ConfigError(
            f"{where}: x_mm, y_mm: found no values, expected both values; "
            "only a ball press may omit them"
        )
    # x and y already give the indenter's place in the image, so the drag does not matter.
    drag = [values.get(column, 0.0) for column in MORE[:3]]
    return KnownPress(
        f"{where}: {row['image']}" if "image" in row else where,
        image,
        0.0 if isinstance(indenter, Indenter) else indenter,
        values["depth_mm"],
        values.get("x_mm"),
        values.get("y_mm"),
        solid,
        *drag,
    )
