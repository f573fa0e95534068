"""Shows which judge lets a picture pass or refuses it, with each figure and its limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tacshade_edge.errors import DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import Reason, reason_fields
from tacshade_edge.sensor.frame_check import Measured, first_reason, size_reason
from tacshade_edge.sensor.frame_check.turned import with_turn
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration

UNEXPLAINED_MOST = 1.0
"""A map that leaves this share of a picture's change unexplained is as good as none."""


@dataclass(frozen=True, slots=True)
class Judged:
    """A picture, what the judges measured of it until one refused, and that one's reason."""

    path: Path
    measured: tuple[Measured, ...] = ()
    reason: Reason | None = None

    @property
    def judge(self) -> str:
        """The name of the judge that refuses; empty if none does."""
        refusing = next((each.judge for each in self.measured if each.refuses), "picture")
        return refusing if self.reason else ""

    def as_dict(self) -> dict[str, object]:
        """The picture's record for programs; no limit is null."""
        names = ("judge", "what", "found", "least", "most")
        figures = [{name: _finite(getattr(each, name)) for name in names} for each in self.measured]
        return {
            "image": str(self.path),
            "judge": self.judge or None,
            **reason_fields(self.reason),
            "figures": figures,
        }


def judge_pictures(
    calibration: Calibration, profile: str, paths: Sequence[Path]
) -> Iterator[Judged]:
    """Judge each picture as the profile would; the picture's own judge refuses one
    that cannot be read.
    """
    # The judges of the daemon themselves, not a copy: what is shown here is what refuses there.
    reconstructor = make_reconstructor(calibration, PROFILES[profile])
    for path in paths:
        try:
            image = read_image(path)
        except DecodeError as error:
            # The other pictures are judged all the same.
            yield Judged(path, reason=error.reason)
            continue
        size = calibration.image_height_px, calibration.image_width_px
        reason, measured = size_reason(image, size), tuple[Measured, ...]()
        if reason is None:
            # Judges end at the first that refuses, as for a frame: later ones presume what it
            # found.
            measured = reconstructor.measured(image)
            reason = first_reason(measured)
        if reason is not None:
            reason = with_turn(reason, image, size, partial(_passes, reconstructor))
        yield Judged(path, measured, reason)


def _passes(reconstructor: Reconstructor, image: U8) -> bool:
    return first_reason(reconstructor.measured(image)) is None


def figures(judged: Sequence[Judged]) -> list[str]:
    """A line for each figure: its judge, the range over all pictures, its limits,
    and how many pictures they refuse.
    """
    by_figure: dict[tuple[str, str], list[Measured]] = {}
    for each in (measured for one in judged for measured in one.measured):
        by_figure.setdefault((each.judge, each.what), []).append(each)
    lines = [
        f"{'judge':<8} {'figure':<37} {'found':<18} {'limits':<18} {'pictures':>8} {'refused':>8}"
    ]
    for (judge, what), some in by_figure.items():
        found, limits = [each.found for each in some], (some[0].least, some[0].most)
        between = f"{min(found):.3g} to {max(found):.3g}"
        refused = sum(each.refuses for each in some)
        lines.append(
            f"{judge:<8} {what:<37} {between:<18} {limits_of(*limits):<18} {len(some):>8} "
            f"{refused:>8}"
        )
    return lines


def doubts(left: Mapping[Path, float]) -> tuple[list[str], bool]:
    """What the shares that maps leave unexplained say of pictures, in lines, and whether most maps
    explain nothing: then one line names the likely cause, instead of one for each picture.
    """
    if not left:
        return [], False
    low, high = 100 * min(left.values()), 100 * max(left.values())
    lines = [f"maps leave {low:.0f} to {high:.0f} % of {len(left)} pictures' changes unexplained"]
    wrong = {path: share for path, share in left.items() if share >= UNEXPLAINED_MOST}
    if 1 < len(left) < 2 * len(wrong):
        lines.append(
            f"{len(wrong)} of {len(left)} maps explain their pictures no better than no contact: "
            "are these pictures of this calibration's sensor?"
        )
        return lines, True
    lines += [
        f"{shown(path)}: its map explains the picture no better than no contact "
        f"({100 * share:.0f} % left)"
        for path, share in wrong.items()
    ]
    return lines, False


def limits_of(least: float, most: float) -> str:
    if math.isinf(most):
        return f"at least {least:.3g}"
    return f"at most {most:.3g}" if least <= 0 else f"{least:.3g} to {most:.3g}"


def _finite(value: str | float) -> str | float | None:
    return value if isinstance(value, str) or math.isfinite(value) else None
