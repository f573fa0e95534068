"""How late a scale's readings are against the pictures: where its force follows the picture's change best."""

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
    """A picture of time t shows the force of the scale's time t + `offset_s`; one standard error beside it."""

    offset_s: float
    error_s: float
    presses: int


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """What was seen from before a press until after it was lifted: times in s and the picture's change, both (n,)."""

    t_s: F64
    change: F64


def find_offset(presses: Sequence[Press], t_s: F64, force: F64) -> ClockOffset:
    """Find the offset from each press by itself; their scatter is its error.

    Each press is correlated (Pearson) with the force at every lag from -`RANGE_S` to `RANGE_S`; a parabola through the
    greatest correlation and its neighbours places it between the steps.

    Parameters
    ----------
    presses : sequence of Press
    t_s, force : float64 (m,)
        The scale's readings as they arrived, ascending.

    Raises
    ------
    ValueError
        ``found …, expected …``: it cannot be found.
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
    """One press's lag; None where nothing in it fits, or the best lies at the end of the range."""
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
