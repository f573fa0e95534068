"""The delay of a scale's readings after the pictures: the lag at which force and picture change correlate best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F64

RANGE_S, _STEP_S = 1.0, 0.005
PRESSES_LEAST = 3
_CORRELATION_LEAST = 0.8
ERROR_MOST_S = 0.05


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """A scale's clock offset and its standard error: a picture of time t shows the force read at t + `offset_s`."""

    offset_s: float
    error_s: float
    presses: int


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """Times in s and the picture's change, both (n,), from before a press until after it was lifted."""

    t_s: F64
    change: F64


def find_offset(presses: Sequence[Press], t_s: F64, force: F64) -> ClockOffset:
    """Find the offset as the mean lag of the presses; their scatter gives its standard error.

    Each press is correlated (Pearson) with the force at every lag from -`RANGE_S` to `RANGE_S`; a parabola through the
    greatest correlation and its neighbours locates the peak between the steps.

    `t_s`, `force` (float64 (m,)): the scale's readings and their arrival times, ascending. Raises ValueError (``found
    …, expected …``: why the offset cannot be found).
    """
    lags = [lag for press in presses if (lag := _lag_s(press, t_s, force)) is not None]
    if len(lags) < PRESSES_LEAST:
        found = f"found {len(lags)} presses (of {len(presses)}) in which picture and force rise and fall together"
        raise ValueError(f"{found}, expected at least {PRESSES_LEAST}, each pressed and lifted while recording")
    error_s = float(np.std(lags, ddof=1) / np.sqrt(len(lags)))
    if error_s > ERROR_MOST_S:
        found = f"found clock offsets that differ by {1e3 * np.ptp(lags):.0f} ms between presses"
        raise ValueError(f"{found}, expected a standard error of at most {1e3 * ERROR_MOST_S:.0f} ms")
    return ClockOffset(float(np.mean(lags)), error_s, len(lags))


def _lag_s(press: Press, t_s: F64, force: F64) -> float | None:
    """Return one press's lag in s; None if it correlates too weakly or best at the end of the range."""
    if len(press.t_s) < 5 or len(t_s) < 5:
        return None
    lags = np.arange(-RANGE_S, RANGE_S + _STEP_S / 2, _STEP_S)
    seen = press.change - press.change.mean()
    read = np.interp(press.t_s[None, :] + lags[:, None], t_s, force)
    read -= read.mean(axis=1, keepdims=True)
    size = np.sqrt((read * read).sum(axis=1) * (seen @ seen))
    found = np.divide(read @ seen, size, out=np.zeros(len(lags)), where=size > 0)
    at = int(found.argmax())
    if not 0 < at < len(lags) - 1 or found[at] < _CORRELATION_LEAST:
        return None
    before, best, after = found[at - 1 : at + 2]
    bend = before - 2 * best + after
    return float(lags[at] + (_STEP_S * 0.5 * (before - after) / bend if bend < 0 else 0.0))
