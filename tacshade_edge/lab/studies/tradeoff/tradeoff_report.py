"""Rows of a measurement for people (Markdown, a plot), programs (CSV, JSON),
settings files and the list of boards.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tacshade_edge.doctor.tail import Tail
from tacshade_edge.lab.parallel import usable_cores
from tacshade_edge.lab.studies import markdown
from tacshade_edge.lab.studies.evaluate.accuracy import versions
from tacshade_edge.lab.studies.markdown import number
from tacshade_edge.lab.studies.tradeoff.judging import OUTPUTS
from tacshade_edge.lab.studies.tradeoff.measure import Estimate, Offer, Promise, relative_errors
from tacshade_edge.quoting import counted

HAND = 4
"""Number of fingers for which the table shows a rate."""
HALF_WORSE = 1.05
"""Images of half the size must be this much more accurate to be chosen,
because they need another calibration.
"""
LOST_MAX = 0.01
"""A daemon that loses a greater share of its frames does not hold the rate."""
_COLOURS = ("#8a5fb0", "#e4572e", "#4a9c5d", "#3d6fb4")


def table(rows: Sequence[Offer]) -> str:
    """A Markdown table: a line for each row."""
    header = (
        "what",
        "profile",
        "image",
        "networks",
        "error",
        "p50 ms",
        "p99 ms",
        "idle ms",
        "MiB",
        "fps, 1 core",
    )
    lines = [
        [
            ", ".join(row.outputs),
            row.setting.profile,
            row.image,
            "fitted" if row.setting.fitted else "shipped",
            _error(*next(iter(row.errors.items()))) if len(row.errors) == 1 else _errors(row),
            *(number(ms, ".2f") for ms in (row.times.p50_ms, row.times.p99_ms, row.times.idle_ms)),
            number(row.peak_mib, ".0f"),
            *(
                number(row.fps(fingers, cores), ".0f")
                for fingers, cores in ((1, 1), (HAND, usable_cores()))
            ),
            "yes" if row.front else "",
        ]
        for row in rows
    ]
    return markdown.markdown((*header, f"fps, {HAND} fingers", "front"), lines)


def _error(name: str, found: Estimate) -> str:
    unit, spec = OUTPUTS[name].unit, OUTPUTS[name].spec
    interval = "" if math.isnan(found.low) else f" ({found.low:{spec}} to {found.high:{spec}})"
    return "" if math.isnan(found.value) else f"{found.value:{spec}}{interval} {unit}"


def _errors(row: Offer) -> str:
    """The known errors in the order of the row's outputs."""
    known = (
        (OUTPUTS[name], found.value)
        for name, found in row.errors.items()
        if math.isfinite(found.value)
    )
    return ", ".join(f"{value:{output.spec}} {output.unit}" for output, value in known)


def record(row: Offer) -> dict[str, Any]:
    """A row as one flat record."""
    line: dict[str, Any] = {
        "outputs": " ".join(row.outputs),
        "profile": row.setting.profile,
        "image": row.image,
        "fitted": row.setting.fitted,
    }
    for name in OUTPUTS:
        found = row.errors.get(name, Estimate(math.nan, math.nan, math.nan))
        line |= {f"{name}_error": found.value, f"{name}_low": found.low, f"{name}_high": found.high}
    line |= {
        name: getattr(row, name)
        for name in ("scenes", "missed", "untouched", "phantoms", "peak_mib", "front")
    }
    line |= asdict(row.times)
    line |= {"fps_core": row.fps(1, 1), "fps_fingers": row.fps(HAND, usable_cores())}
    names = ("p50_ms", "p99_ms", "lost", "control_p99_ms")
    kept = [getattr(row.promise, name, math.nan) for name in names]
    return line | {f"daemon_{name}": value for name, value in zip(names, kept, strict=True)}


def csv_text(rows: Sequence[Offer]) -> str:
    """CSV with one line for each row; NaN is empty."""
    records = [record(row) for row in rows]
    return markdown.csv_lines(list(records[0]), [list(each.values()) for each in records])


def document(rows: Sequence[Offer], busy: float) -> dict[str, Any]:
    """All rows for JSON, with machine, versions and how busy the machine was."""
    machine = {
        "machine": platform.machine(),
        "system": platform.platform(),
        "cores": usable_cores(),
        "busy": busy,
    }
    found: dict[str, Any] = markdown.without_nan(
        {"board": machine, "versions": versions(), "rows": [record(row) for row in rows]}
    )
    return found


@dataclass(frozen=True, slots=True)
class Wish:
    """What a user needs of a machine with `cores`; None: any."""

    budget_ms: float | None
    fps: float | None
    fingers: int
    cores: int

    def held_by(self, row: Offer) -> bool:
        """Whether 99 of 100 frames in contact stay within the budget,
        and all fingers can have the rate: in the daemon's own run, if it was tried undisturbed.
        """
        budget_ms = math.inf if self.budget_ms is None else self.budget_ms
        if (promise := row.promise) is not None and not promise.is_disturbed:
            is_lossy = self.fps is not None and promise.lost > LOST_MAX * promise.frames
            return promise.p99_ms <= budget_ms and not is_lossy
        in_time = row.times.p99_ms <= budget_ms
        return in_time and row.fps(self.fingers, self.cores) >= (self.fps or 0)

    def __str__(self) -> str:
        """For people."""
        parts = [f"{counted(self.fingers, 'finger')} on {counted(self.cores, 'core')}"]
        parts += [] if self.fps is None else [f"{self.fps:g} frames/s"]
        return ", ".join(
            parts + ([] if self.budget_ms is None else [f"{self.budget_ms:g} ms (p99)"])
        )


def choose(rows: Sequence[Offer], wish: Wish) -> tuple[Offer | None, str]:
    """The most accurate of rows of the same outputs that holds, and it
    as YAML for a settings file, with what is given up.

    None and one line, if none holds. Networks run fitted where they are fitted:
    a user cannot choose.
    """
    fitted = {row.setting.profile for row in rows if row.setting.fitted}
    # A daemon runs fitted networks where there are some: others are measured, and not offered.
    usual = [
        r
        for r in rows
        if math.isfinite(r.times.p99_ms) and r.setting.fitted == (r.setting.profile in fitted)
    ]
    if not usual:
        return None, "nothing holds: no setting found a contact"
    # Unknown errors go last, in order of time.
    errors = np.nan_to_num(relative_errors(usual), nan=np.inf) * [
        HALF_WORSE if r.setting.half else 1 for r in usual
    ]
    ranked = [
        usual[k]
        for k in sorted(range(len(usual)), key=lambda k: (errors[k], usual[k].times.p50_ms))
    ]
    what = f"{', '.join(usual[0].outputs)} for {wish}"
    found = next((row for row in ranked if wish.held_by(row)), None)
    if found is None:
        fastest = min(usual, key=lambda row: row.times.p99_ms)
        return None, f"nothing holds {what}; the fastest is {_said(fastest, wish)}"
    lines = [f"# {what}:", f"# {_said(found, wish)}"]
    given_up = (
        "nothing, no other is more accurate" if found is ranked[0] else _said(ranked[0], wish)
    )
    lines += [f"# given up: {given_up}", f"profile: {found.setting.profile}"]
    # The size of the calibration needs no line: a daemon takes it from there.
    size = {"width_px": found.width_px, "height_px": found.height_px} if found.setting.half else {}
    source = size | ({} if wish.fps is None else {"fps": math.ceil(wish.fps)})
    if source and wish.fingers == 1:
        lines += [
            "source:",
            "  kind: v4l2  # or your camera's",
            *(f"  {key}: {n}" for key, n in source.items()),
        ]
    elif source:
        lines.append(
            f"# source of each sensor: {', '.join(f'{key}: {n}' for key, n in source.items())}"
        )
    if size:
        lines.append("# calibrate again at this image size")
    return found, "\n".join([*lines, *_promised(found.promise)])


def _promised(promise: Promise | None) -> list[str]:
    """What the daemon's own run showed, if there was one."""
    if promise is None:
        return []
    disturbed = "; other programs disturbed both, so times of the processor chose the settings"
    return [
        f"# the daemon itself, here, through {promise.through}: decoded messages are "
        f"{promise.p50_ms:.1f} ms old (p50), {promise.p99_ms:.1f} ms (p99); "
        f"lost after the first second: {promise.lost} of {counted(promise.frames, 'frame')}",
        f"# control: plain work of {promise.control_ms:.1f} ms ends within "
        f"{promise.control_p99_ms:.1f} ms (p99){disturbed * promise.is_disturbed}",
    ]


def tail_line(offer: Offer, tail: Tail, reason: str) -> str:
    """What the machine makes of plain work that lasts as long as the offer's frames, and why no
    daemon was tried.
    """
    return (
        f"# the daemon was not tried ({reason}), so this ends when a message is encoded: "
        f"plain work of {tail.processor_p50_ms:.1f} ms ends within {tail.p99_ms:.1f} ms in 99 % "
        f"({tail.ratio:.1f} times); expect {tail.ratio * offer.times.p99_ms:.1f} ms"
    )


def _said(row: Offer, wish: Wish) -> str:
    rate = f"at most {row.fps(wish.fingers, wish.cores):.0f} frames/s"
    return f"{row.setting.profile} at {row.image}: off by {_errors(row)}; {_p99(row)}, {rate}"


def _p99(row: Offer) -> str:
    if row.promise is None:
        return f"p99 of processor time {row.times.p99_ms:.2f} ms"
    return f"p99 {row.promise.p99_ms:.1f} ms at the subscriber, {row.promise.lost} frames lost"


def draw(rows: Sequence[Offer], budget_ms: float | None) -> bytes:
    """Plot error against p50 as a PNG: a panel for each output, with intervals,
    front and budget.
    """
    # Rows of one output have a panel each; a row of several would repeat them.
    single = [row for row in rows if len(row.outputs) == 1] or rows
    panels = [
        (r.outputs, name)
        for r in single
        for name in r.outputs
        if math.isfinite(r.errors[name].value)
    ]
    panels = list(dict.fromkeys(panels))
    columns = min(3, max(1, len(panels)))
    # One panel at least: a figure without any cannot be drawn.
    lines = -(-max(1, len(panels)) // columns)
    figure, axes = markdown.new_figure(lines, columns, 4.6 * columns, 3.4 * lines + 0.8)
    profiles = list(dict.fromkeys(row.setting.profile for row in rows))
    for one, (outputs, name) in zip(axes.flat, panels, strict=False):
        mine = [
            row
            for row in rows
            if row.outputs == outputs and math.isfinite(row.errors[name].value + row.times.p50_ms)
        ]
        for row in mine:
            _mark(one, row, name, _COLOURS[profiles.index(row.setting.profile) % len(_COLOURS)])
        _finish(one, mine, name, budget_ms)
    for one in axes.flat[len(panels) :]:
        one.set_axis_off()
    figure.legend(
        *axes.flat[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=4,
        frameon=False,
    )
    return markdown.png(figure)


def _mark(panel: Any, row: Offer, name: str, colour: str) -> None:
    """Mark an output's error and its interval."""
    found = row.errors[name]
    known = not math.isnan(found.low)
    panel.errorbar(
        row.times.p50_ms,
        found.value,
        yerr=[[found.value - found.low], [found.high - found.value]] if known else None,
        color=colour,
        linewidth=0.8,
        label=f"{row.setting.profile}, {row.image}{', fitted' * row.setting.fitted}",
        fmt="o" if row.setting.half else "D",
        mfc=colour if row.setting.fitted else "white",
    )


def _finish(panel: Any, rows: Sequence[Offer], name: str, budget_ms: float | None) -> None:
    """Draw the front and the budget, and name the axes."""
    front = sorted((row.times.p50_ms, row.errors[name].value) for row in rows if row.front)
    panel.plot(*zip(*front, strict=True), color="#888888", linewidth=1.2, zorder=1, label="front")
    if budget_ms is not None:
        label = f"budget, {budget_ms:g} ms"
        panel.axvline(budget_ms, color="#888888", linestyle=":", label=label)
    panel.set(
        title=name,
        xlabel="ms of a frame in contact, p50",
        ylabel=f"{OUTPUTS[name].what}, {OUTPUTS[name].unit}",
    )
    panel.set_xlim(left=0)
    panel.set_ylim(bottom=0)
