"""Claims about hands, servo loops and flanges."""

from __future__ import annotations

import re

import pytest

from support.result_page import Claims, Page, rounded

MARGINS = (
    ("usual (ball, cube)", "usual"),
    ("other friction", "other friction"),
    ("other objects (cylinder, cone)", "other objects"),
    ("the other family, with other mechanics", "other mechanics"),
)


def margin() -> Claims:
    page = Page("margin")
    slips = announced = 0.0
    for title, group in MARGINS:
        count, share, lead_ms, alarms, minutes = (
            page.number(column, group)
            for column in ("slips", "announced %", "median lead ms", "false alarms", "minutes held")
        )
        yield (
            f"| {title} | {count:.0f} | {share:.0f} % | {rounded(lead_ms / 1000, 2)} s | "
            f"{alarms:.0f} in {minutes:.0f} minutes |"
        )
        slips, announced = slips + count, announced + count * share / 100
    yield f"it announces {round(100 * announced / slips)} % of the first slips"


def hand() -> Claims:
    page = Page("../decisions/0010-several-sensors")
    column = "memory, MB"
    (together,) = page.cells(column, "one command, forked processes")
    (apart,) = page.cells(column, "five commands, as with a systemd template unit")
    yield f"Five sensors in one service take {together} MB of memory; five services would take {apart} MB"


def flange() -> Claims:
    page, noise = Page("flange"), "0.3 mm, 0.3°"
    ((mm, _, mm_in), (deg, _, deg_in), (ms, _, ms_in)) = (
        re.split("[,;] ", page.cells(column, noise)[0])
        for column in ("mm: median, worst; within 0.5", "degrees; within 0.7", "ms; within 5")
    )
    assert ms_in == "20 of 20"
    yield f"the median errors were {mm} mm, {deg}° and {ms} ms"
    yield f"{int(mm_in.split()[0])} were within 0.5 mm, {int(deg_in.split()[0])} within 0.7° and all within 5 ms"


def object_motion() -> Claims:
    page = Page("object-motion")
    held = [int(cell) for cell in page.cells("in the 90 % ellipsoid %", "all")]
    yield f"90 % ellipsoid contains {min(held)} to {max(held)} %"
    within = [int(cell) for cell in page.cells("within 0.4 mm and 3° %", "all", "5")[:4]]
    yield f"within 0.4 mm and 3° in {min(within)} to {max(within)} % of 30 trials"
    yield f"never jumps by more than {max(page.cells('jump mm: greatest', 'all'))} mm"


SERVO = (
    ("`follow_surface`", "follow_surface", ("depth mm", "tilt x deg", "tilt y deg"), ("5", "20")),
    ("the same without labels", "follow_surface, without labels", ("depth mm", "tilt x deg", "tilt y deg"), ("10",)),
    ("`follow_edge`", "follow_edge", ("depth mm", "y mm", "edge deg"), ("5", "20")),
)


def servo() -> Claims:
    for loop, part, columns, speeds in SERVO:
        page = Page("servo", part=part)
        for speed in speeds:
            errors = [
                ", ".join(page.cell(column, speed, added).partition(" ")[0] for column in columns)
                for added in ("0", "100")
            ]
            yield f"| {loop} | {speed} | {' | '.join(errors)} |"
    page = Page("servo")
    touches = [int(cell) for cell in page.cells("touches a second")]
    ages = [int(cell) for cell in page.cells("their age, ms")]
    span = f"{min(touches)}" if min(touches) == max(touches) else f"{min(touches)} to {max(touches)}"
    yield f"received {span} touches a second, with a median age of {min(ages)} to {max(ages)} ms"


CLAIMS = (
    pytest.param("docs/how-to/hand.md", object_motion, id="object_motion"),
    pytest.param("docs/how-to/stitching.md", flange, id="flange"),
    pytest.param("docs/how-to/shear.md", margin, id="margin"),
    pytest.param("docs/how-to/touch.md", servo, id="servo"),
    pytest.param("docs/how-to/hand.md", hand, id="hand"),
)
