"""Figures that the documents quote are those of their page of docs/results.

A claim is a sentence or table line, made here from a page's figures, that must stand in its document word for word.
After a page was made again, a failure shows the line as it has to read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from decimal import ROUND_HALF_UP, Decimal
from functools import cache
from pathlib import Path

import pytest

from tools.testbed.simulator.families import FINAL_SENSORS

ROOT = Path(__file__).parents[2]
PROFILES = ("accurate", "balanced", "fast")
LIMITS_ORDER = ("fast", "balanced", "accurate")
FAMILIES = {"training family": "tacshade", "other family": "other"}
WORDS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
Claims = Iterable[str]
"""Sentences and lines; spaces and line ends count alike."""


def flat(text: str) -> str:
    """With single spaces, so that a claim may run over lines."""
    return " ".join(text.split())


@cache
def document(path: str) -> str:
    return flat((ROOT / path).read_text(encoding="utf-8"))


def rounded(value: str | float, digits: int) -> str:
    """A half goes up, as a reader rounds; what was computed is taken to a millionth."""
    exact = Decimal(value) if isinstance(value, str) else Decimal(f"{value:.6f}")
    return str(exact.quantize(Decimal(1).scaleb(-digits), ROUND_HALF_UP))


class Page:
    """The tables of a page, of one family of sensors on it, or below one of its headings."""

    def __init__(self, name: str, family: str = "", part: str = "") -> None:
        text = (ROOT / "docs" / "results" / f"{name}.md").read_text(encoding="utf-8")
        if family:
            parts = re.split(r"^(?:Family (\w+)|Both families)$", text, flags=re.MULTILINE)
            text = parts[parts.index(family) + 1]
        if part:
            text = text.partition(f"## {part}\n")[2].partition("\n## ")[0]
        self.name = name
        blocks = re.findall(r"(?:^\|.*\|\n)+", text + "\n", re.MULTILINE)
        self._tables = [
            [[cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines()] for block in blocks
        ]

    def cells(self, column: str, *row: str) -> list[str]:
        """The column's cell in each line that begins with `row`."""
        found = []
        for header, _, *lines in self._tables:
            if column in header:
                found += [line[header.index(column)] for line in lines if tuple(line[: len(row)]) == row]
        return found

    def cell(self, column: str, *row: str) -> str:
        """The same, of which there is one."""
        found = self.cells(column, *row)
        assert len(found) == 1, f"{self.name}: {len(found)} cells {column!r} in lines {row}"
        return found[0]

    def number(self, column: str, *row: str) -> float:
        return float(self.cell(column, *row))

    def header(self, column: str) -> list[str]:
        """The column names of the table that has `column`."""
        (header,) = (table[0] for table in self._tables if column in table[0])
        return header


def objects() -> Claims:
    of = {title: Page("objects", family) for title, family in FAMILIES.items()}
    for title, page in of.items():
        for profile in (*PROFILES, "paper"):
            mean, worst = ("mean", profile), ("worst object", profile)
            cells = (page.cell("ME mm", *mean), page.cell("ME mm", *worst), page.cell("back mm", *mean))
            rest = (page.cell(name, *mean) for name in ("SD %", "IoU", "depth off %", "worst %", "missed"))
            yield f"| {' | '.join((title, profile, *cells, *rest))} |"
    trained, other = of.values()
    beats = {page.cell("beats Table I in ME and SD", profile) for page in of.values() for profile in PROFILES}
    assert beats == {"4 of 5"}, "the sentence on the objects of Table I has to be written anew"
    yield "On both families, `accurate`, `balanced` and `fast` have a better ME and SD than Table I on four of the five"
    frames = sum(int(page.cell("frames without contact", "accurate")) for page in of.values())
    assert all(page.cell("phantoms", profile) == "0" for page in of.values() for profile in PROFILES)
    yield f"The learned profiles found no phantom in {frames} frames without contact."
    spans = []
    for page, family in ((trained, "tacshade"), (other, "other")):
        sensors = [str(sensor) for sensor in FINAL_SENSORS if sensor.family == family]
        single = [page.number("ME mm", sensor, "accurate") for sensor in sensors]
        spans.append(f"{rounded(min(single), 2)} to {rounded(max(single), 2)} mm")
    yield f"mean ME with `accurate` is {spans[0]} on the training family and {spans[1]} on the other."
    table = ("mean", "Table I (real sensor)")
    yield f"has a mean ME of {trained.cell('ME mm', *table)} mm and an SD of {trained.cell('SD %', *table)} %"
    yield f"the ball, which has an SD of {trained.cell('SD %', 'ball', 'Table I (real sensor)')} % in Table I"


def readme() -> Claims:
    """The default profile's, wherever a page has profiles."""
    assert re.search(r"^profile: balanced$", (ROOT / "config/default.yaml").read_text(encoding="utf-8"), re.MULTILINE)
    trained, other = (Page("objects", family) for family in FAMILIES.values())
    mean = ("mean", "balanced")
    error, elsewhere = (rounded(page.cell("ME mm", *mean), 2) for page in (trained, other))
    yield f"**{error} mm** mean distance from the true surface ({elsewhere} mm on another sensor family)"
    depth = ("balanced", "depth")
    real = Page("real-raw")
    order, off = real.cell("rank correlation", *depth), real.cell("mean error", *depth)
    presses = real.cell("frames", *depth)
    yield (
        f"**{order}** rank correlation with true depth, {off} mm mean error after a linear fit | "
        f"{presses} presses of a real TacTip"
    )
    latency = Page("daemon")
    yield f"**{latency.cell('p50 ms', 'contact')} ms** latency, 99 % within {latency.cell('p99 ms', 'contact')} ms"
    frame_ms = Page("arm").cell("Pi 5 (Cortex-A76, 2.4 GHz), ms", "balanced", "contact").split(" to ")
    cores = [rounded(5 * 30 * float(ms) / 10, 0) for ms in frame_ms]
    yield f"**Five fingers** at 30 frames/s use {cores[0]} to {cores[1]} % of a core"


DRAGS = ("0 mm", "1 mm", "2 mm", "3 mm", "3 mm, twist 10°, tilt 15°")


def drag() -> Claims:
    trained, other = (Page("drag", family) for family in FAMILIES.values())
    rows = [(f"training family, {profile}", trained, profile) for profile in PROFILES]
    rows.append(("other family (other mechanics), accurate", other, "accurate"))
    for title, page, profile in rows:
        still, _, *dragged = (rounded(page.cell("ME mm", what, profile), 2) for what in DRAGS)
        yield f"| {title} | {' | '.join((still, *dragged))} |"
    frames, refused = (
        sum(int(trained.cell(column, "all", profile)) for profile in PROFILES) for column in ("frames", "refused")
    )
    yield f"On the training family, the profiles refused {refused} of {frames} frames."


def shear_under_drag() -> Claims:
    trained, other = (Page("drag", family) for family in FAMILIES.values())
    for page, begin in (
        (trained, "median error of a contact's mean shear is "),
        (other, "too small, with median errors of "),
    ):
        one, two, three = (page.cell("shear off mm: median", what, "accurate") for what in DRAGS[1:4])
        yield f"{begin}{one}, {two} and {three} mm."
    one, two, three = (trained.cell("within 0.35 mm or a tenth %", what, "accurate") for what in DRAGS[1:4])
    yield f"within 0.35 mm or a tenth of the shear in {one}, {two} and {three} % of `accurate`'s contacts."
    direction = max(trained.number("direction off °: 95 %", what, "accurate") for what in DRAGS[1:4])
    twist = max(trained.number("twist off °: 95 %", what, "accurate") for what in DRAGS[1:4])
    yield f"the errors are at most {direction:.0f}° in direction and {math.ceil(twist)}° in twist; if the object"
    yield f"tilted by 15°, the twist error is at most {trained.cell('twist off °: 95 %', DRAGS[4], 'accurate')}°"


def no_presses() -> Claims:
    trained, other = (Page("no-presses", family) for family in FAMILIES.values())
    with_presses = Page("objects", "other").cell("ME mm", "mean", "balanced")
    mean = ("mean", "accurate")
    yield f"`accurate` has an ME of {trained.cell('ME mm', *mean)} mm and an SD of {trained.cell('SD %', *mean)} %"
    yield f"and {other.cell('ME mm', *mean)} mm and {other.cell('SD %', *mean)} % on the other."
    yield f"(`balanced` improves from an ME of {other.cell('ME mm', 'mean', 'balanced')} to {with_presses} mm)"


def other_objects() -> Claims:
    trained, other = (Page("other-objects", family) for family in FAMILIES.values())
    yield f"A cone's tip appears {trained.cell('depth off %', 'cone', 'accurate')} % too shallow with `accurate`"
    cones = [int(other.cell("depth off %", "cone", profile)) for profile in PROFILES]
    yield f"and {min(cones)} to {max(cones)} % too shallow on the other family"
    plates = [page.cell("missed", "plate", profile).split("/") for page in (trained, other) for profile in PROFILES]
    yield f"up to {max(int(missed) for missed, _ in plates)} of {plates[0][1]} presses"


def limits() -> Claims:
    page = Page("limits")

    def line(title: str, cells: Iterable[str]) -> str:
        return f"| {title} | {' | '.join(cells)} |"

    def least_depth(what: str, profile: str) -> str:
        depths = [name for name in page.header("0.35 mm") if name.endswith(" mm")]
        return next(name for name in depths if page.number(name, what, profile) >= 90).removesuffix(" mm")

    total = page.cell("frames", "all of these", "fast")
    yield line(
        f"phantoms in {total} frames without contact, under normal disturbances",
        (page.cell("phantoms", "all of these", profile) for profile in LIMITS_ORDER),
    )
    for title, what in (
        ("least depth at which 90 % of ball presses are found (radius 6 mm)", "ball, radius 6 mm"),
        ("least depth at which 90 % of ball presses are found (radius 3 mm)", "ball, radius 3 mm"),
    ):
        yield line(title, (least_depth(what, profile) for profile in LIMITS_ORDER))
    for title, depth in (("mean depth error with a ball pressed 3 mm deep", 3), ("6 mm deep", 6), ("8 mm deep", 8)):
        yield line(title, (page.cell(f"{depth} mm", "ball, mean", profile) for profile in LIMITS_ORDER))
    for title, what in (
        ("least gap at which two bars are found as two objects (marker pitch 1.8 mm)", "gap: two objects"),
        (
            "narrowest ridge whose height is measured to within 20 % (marker pitch 1.8 mm)",
            "ridge: height within 20 %",
        ),
    ):
        yield line(title, (page.cell("pitch 1.8", what, profile) for profile in LIMITS_ORDER))
    for title, what in (
        ("mean change in a 2 mm depth after a camera shift of 1 px, %", "moved by 1 px"),
        ("mean change in a 2 mm depth under a spot of glare, %", "glare spot"),
    ):
        yield line(title, (page.cell("mean %", what, profile) for profile in LIMITS_ORDER))
    dents, glare = (
        sum(int(page.cell("phantoms", what, profile)) for profile in PROFILES)
        for what in ("after a release", "glare spot")
    )
    assert glare == 0
    yield f"All {WORDS[dents]} phantoms were dents seen just after a release"
    yield "spots of glare caused none"
    assert dents + glare == sum(int(page.cell("phantoms", "all of these", profile)) for profile in PROFILES)


def sigma() -> Claims:
    spans, most = [], 0.0
    for family in FAMILIES.values():
        page = Page("sigma", family)
        held = [
            page.number("in the 90 % interval %", f"{mm} mm of drag", profile) for profile in PROFILES for mm in (0, 2)
        ]
        spans.append(f"{rounded(min(held), 0)} to {rounded(max(held), 0)} %")
        most = max(most, *(page.number("of greatest error %", "all", profile) for profile in PROFILES))
    yield f"hold {spans[0]} of the errors on sensors like those seen in training, and {spans[1]} on another family"
    yield f"Even the worst tenth of the cells contributes at most {math.ceil(most)} % of the error"


def stages() -> Claims:
    page = Page("stages")
    floor = page.number("p50 ms", "floor")
    yield f"| floor | {rounded(floor, 2)} | | 1.0 | | |"
    for profile in LIMITS_ORDER:
        in_contact = (profile, "contact")
        shear, deviation = page.number("shear", *in_contact), page.number("sigma", *in_contact)
        depth_alone = page.number("p50 ms", *in_contact) - shear - deviation
        times = depth_alone / floor
        free = page.number("p50 ms", profile, "no contact")
        ms = [rounded(value, 2) for value in (free, depth_alone, shear, deviation)]
        yield f"| {profile} | {ms[0]} | {ms[1]} | {rounded(times, 0 if times >= 10 else 1)} | {ms[2]} | {ms[3]} |"


def stages_in_numerics() -> Claims:
    page = Page("stages")
    floor = page.number("p50 ms", "floor")
    halved, full = (
        rounded(sum(page.number(stage, profile, "contact") for stage in ("check", "grey", "gate")) / floor, 1)
        for profile in ("balanced", "accurate")
    )
    yield (
        f"Checking a frame for contact takes {halved} times as long as a threshold and a box filter if the image is "
        f"halved first, and {full} times at full resolution"
    )


def as_printed() -> Claims:
    page = Page("as-printed")
    paper, times = (rounded(page.cell(column, "paper"), 0) for column in ("p50 ms", "times balanced"))
    yield f"`paper` takes {paper} ms per frame, {times} times as long as `balanced` with shear and σ."
    yield f"A literal implementation of the paper takes {rounded(page.cell('p50 ms', 'plain'), 0)} ms"


def paper_in_the_settings() -> Claims:
    yield f"about {rounded(Page('as-printed').number('p50 ms', 'paper') / 1000, 1)} s per frame"


def iterations() -> Claims:
    slow, quick = (Page("iterations").number("ms of processor time (p50)", name) for name in ("paper", "paper_0"))
    assert round(7 * (1 - quick / slow)) == 6
    yield "takes six sevenths of `paper`"


def tradeoff() -> Claims:
    page = Page("tradeoff")
    shipped, whole = "**as shipped**", "not halved"
    for profile in ("fast", "balanced"):
        quick, slow = (float(page.cells("p50 ms", profile, what)[0].split()[0]) for what in (shipped, whole))
        assert round(4 * (1 - quick / slow)) == 1
    yield "Halving the image saves `fast` and `balanced` a quarter of their time"
    near, far = (float(page.cell("ME mm", "fast", what).split()[0]) for what in (whole, shipped))
    yield f"and increases the ME of `fast` by {rounded(far - near, 2)} mm"


def daemon() -> Claims:
    page = Page("daemon")

    def line(title: str, column: str, row: str = "contact") -> str:
        return f"| {title} | {page.cell(column, row)} | {page.cell(column, f'{row}, null')} |"

    yield line("latency in contact, p50 ms", "p50 ms")
    yield line("latency in contact, p99 ms", "p99 ms")
    yield line("first map after start, s", "first map s")
    yield line("CPU in contact, cores", "CPU core")
    yield line("CPU without contact, cores", "CPU core", "free")
    yield f"| CPU in contact without subscribers, cores | {page.cell('CPU core', 'unasked')} | |"
    yield line("resident memory, MB", "resident MB")


def extra_cores(row: str) -> str:
    """What a row of the page of recordings costs beside the daemon alone."""
    page = Page("recording")
    return rounded(page.number("CPU core", row) - page.number("CPU core", "contact"), 2)


def recording() -> Claims:
    text = (ROOT / "docs" / "results" / "recording.md").read_text(encoding="utf-8")
    grey, colour = (re.findall(rf"^{name}, recorder: ([\d.]+) ms, (\d+) kB$", text, re.MULTILINE)[0] for name in SHOWN)
    cores = sorted(extra_cores(row) for row in ("recording", "recording, mcap"))
    yield f"an extra {cores[0]} to {cores[1]} of a core. Encoding took"
    yield f"{grey[0]} ms for a grey frame of {grey[1]} kB and {colour[0]} ms for a colour frame of {colour[1]} kB"


SHOWN = ("grey", "colour")


def pre_roll() -> Claims:
    yield f"The pre-roll costs {extra_cores('pre-roll')} of a core at 60 frames/s"


def opencv_beside_onnxruntime() -> Claims:
    page = Page("runtime")
    ratios = [page.number("OpenCV p50 ms", name) / page.number("ONNX Runtime p50 ms", name) for name in NETWORKS]
    yield f"takes {rounded(min(ratios), 1)} to {rounded(max(ratios), 1)} times as long for the same files"
    assert max(page.number("greatest difference", name) for name in NETWORKS) <= 2e-5
    yield "its results agree within 2e-5"


def instructions() -> Claims:
    page = Page("runtime-counts")
    for line, column in (
        ("OpenCV 5.0, float", "OpenCV"),
        ("ONNX Runtime 1.32, float", "ONNX Runtime"),
        ("**ONNX Runtime 1.32, our integer graphs**", "integers"),
    ):
        yield f"| {line} | {' | '.join(page.cell(f'{column}, million', name) for name in NETWORKS)} |"


def memory() -> Claims:
    text = (ROOT / "docs" / "results" / "memory.md").read_text(encoding="utf-8")
    found = re.findall(r"^ *(\d+)" + r" +([\d.]+)" * 4 + "$", text, re.MULTILINE)
    of = {int(frames): [rounded(mb, 0) for mb in cells] for frames, *cells in found}
    first, last = of[min(of)], of[max(of)]
    yield f"| profile `balanced` ([page](../results/memory.md)) | {first[0]} | {last[0]} | {last[3]} | {last[1]} |"


def shear() -> Claims:
    one, two, three = (Page("shear").cell("accurate", f"{mm} mm").split()[0] for mm in (1, 2, 3))
    yield f"error under 1, 2 and 3 mm of drag is {one}, {two} and {three} mm with `accurate`"


def runtime() -> Claims:
    page = Page("runtime")
    pairs = (
        f"{page.cell('ONNX Runtime p50 ms', profile)}, {page.cell('integers p50 ms', profile)}"
        for profile in LIMITS_ORDER
    )
    yield f"| network run time, ms ([page](../results/runtime.md)) | {' | '.join(pairs)} |"


NETWORKS = (*LIMITS_ORDER, "shear")


def arm() -> Claims:
    page = Page("arm")
    fast, balanced, accurate = (page.cell("million instructions", profile, "contact") for profile in LIMITS_ORDER)
    yield (
        f"On aarch64, `fast`, `balanced` and `accurate` take {fast}, {balanced} and {accurate} million instructions "
        "for a frame in contact."
    )
    off = {name: max(map(float, page.cells("h, mm at most", name))) for name in (*PROFILES, "paper")}
    network = max(off[name] for name in PROFILES)
    yield (
        f"in five frames, its heights differ from x86-64's by at most {math.ceil(100 * network) / 100:.2f} mm, "
        f"and with `paper` by at most {math.ceil(100 * off['paper']) / 100:.2f} mm ([page](../results/arm.md))"
    )


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


def arm_frame() -> Claims:
    page, row = Page("arm-frame"), ("balanced", "contact")
    boards = [page.cell(f"{board}, ms", *row) for board in ("Pi 5 (Cortex-A76, 2.4 GHz)", "Pi 4 (Cortex-A72, 1.8 GHz)")]
    yield (
        f"takes {page.cell('all', *row)} million instructions for a frame in contact, of which shear takes "
        f"{page.cell('shear', *row)} million. The estimated frame time is {boards[0]} ms on a Pi 5 and {boards[1]} ms "
        "on a Pi 4"
    )


WRONG_PRESSES = (
    ("one depth +1.0, +1.5, +2.0 mm off", tuple(f"one depth {off} mm off" for off in ("+1.0", "+1.5", "+2.0"))),
    ("one depth -1.5 mm off", ("one depth -1.5 mm off",)),
    ("one place 2, 3, 4 mm off", tuple(f"one place {off} mm off" for off in (2, 3, 4))),
    ("x and y swapped at one press", ("x and y swapped at one press",)),
    ("one ball radius times 0.5, 0.67, 1.5, 2", tuple(f"one ball radius times {k}" for k in (0.5, 0.67, 1.5, 2.0))),
)


def wrong_presses() -> Claims:
    page = Page("calibration")
    for title, labels in WRONG_PRESSES:
        found = [page.cell("said", label).split(" of ") for label in labels]
        asked = [page.cell("said", f"capture: {label}").split(" of ")[0] for label in labels]
        yield f"| {title} | {', '.join(hits for hits, _ in found)} of {found[0][1]} | {', '.join(asked)} |"


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


def fit() -> Claims:
    page = Page("fit")
    for title, what in (("pressed", "pressed"), ("dragged", "dragged"), ("both", "half of each")):
        mean, worst = (
            ", ".join(page.cells(f"{what} {of}", profile)[0] for profile in PROFILES) for of in ("mean", "worst")
        )
        yield f"| {title} | {mean} | {worst} |"


def test_a_fit_promises_what_the_page_measured() -> None:
    pytest.importorskip("torch", reason="PyTorch (the extra fit) is not installed")
    from tacshade_edge.fitting.fit import GAIN_ELSEWHERE_PCT

    means = {name: float(Page("fit").cells("half of each mean", name)[0]) for name in PROFILES}
    assert {name: round(100 * (1 - mean)) for name, mean in means.items()} == GAIN_ELSEWHERE_PCT


def object_motion() -> Claims:
    page = Page("object-motion")
    held = [int(cell) for cell in page.cells("in the 90 % ellipsoid %", "all")]
    yield f"90 % ellipsoid contains {min(held)} to {max(held)} %"
    within = [int(cell) for cell in page.cells("within 0.4 mm and 3° %", "all", "5")[:4]]
    yield f"within 0.4 mm and 3° in {min(within)} to {max(within)} % of 30 trials"
    yield f"never jumps by more than {max(page.cells('jump mm: greatest', 'all'))} mm"


def faults() -> Claims:
    page = Page("faults")
    back = max(page.number("recovered s", fault) for fault in ("broker killed, and back", "connection reset"))
    assert back <= 3
    yield "the daemon reconnects within 3 s of the broker's return"
    stalled = [page.number("detected s", fault) for fault in ("broker stalls for 6 s", "network carries nothing")]
    assert min(stalled) >= 4
    assert max(stalled) <= 15
    yield "reports the hang after 4 to 15 s"
    assert page.number("detected s", "lens covered, and uncovered") <= 4
    assert page.number("recovered s", "lens covered, and uncovered") <= 2
    yield "`degraded` within 4 s; frames resume within 2 s of the camera's return"
    assert page.number("recovered s", "no calibration at the start") <= 2
    yield "uses a new calibration within 2 s"


def faults_of_thousands() -> Claims:
    yield f"[{int(Page('faults-damaged').cell('fed', 'all')):,} damaged inputs]".replace(",", " ")
    words = Page("faults-words")
    assert sum(int(words.cell("count", what)) for what in ("in process", "serial lines")) == 1_000_000
    yield "[a million requests and serial lines]"
    yield f"[kill -9, {Page('faults-kills').cell('kills', 'all')} times]"


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
    pytest.param("docs/reference/calibration-checks.md", wrong_presses, id="wrong_presses"),
    pytest.param("README.md", readme, id="readme"),
    pytest.param("docs/explanation/accuracy.md", objects, id="objects"),
    pytest.param("docs/explanation/accuracy.md", drag, id="drag"),
    pytest.param("docs/explanation/accuracy.md", no_presses, id="no_presses"),
    pytest.param("docs/explanation/accuracy.md", other_objects, id="other_objects"),
    pytest.param("docs/explanation/accuracy.md", limits, id="limits"),
    pytest.param("docs/how-to/shear.md", shear_under_drag, id="shear_under_drag"),
    pytest.param("docs/decisions/0008-fit.md", fit, id="fit"),
    pytest.param("docs/how-to/hand.md", object_motion, id="object_motion"),
    pytest.param("docs/how-to/stitching.md", flange, id="flange"),
    pytest.param("docs/how-to/shear.md", margin, id="margin"),
    pytest.param("docs/how-to/touch.md", servo, id="servo"),
    pytest.param("docs/reference/sigma.md", sigma, id="sigma"),
    pytest.param("docs/explanation/speed.md", stages, id="stages"),
    pytest.param("docs/explanation/speed.md", as_printed, id="as_printed"),
    pytest.param("docs/explanation/speed.md", iterations, id="iterations"),
    pytest.param("docs/explanation/speed.md", daemon, id="daemon"),
    pytest.param("docs/explanation/speed.md", tradeoff, id="tradeoff"),
    pytest.param("docs/explanation/speed.md", arm_frame, id="arm_frame"),
    pytest.param("docs/how-to/hand.md", hand, id="hand"),
    pytest.param("docs/explanation/numerics.md", stages_in_numerics, id="stages_in_numerics"),
    pytest.param("docs/explanation/numerics.md", shear, id="shear"),
    pytest.param("docs/explanation/numerics.md", runtime, id="runtime"),
    pytest.param("docs/explanation/numerics.md", arm, id="arm"),
    pytest.param("docs/how-to/service.md", memory, id="memory"),
    pytest.param("docs/how-to/service.md", pre_roll, id="pre_roll"),
    pytest.param("docs/how-to/replay.md", recording, id="recording"),
    pytest.param("docs/decisions/0005-onnxruntime.md", opencv_beside_onnxruntime, id="opencv_beside_onnxruntime"),
    pytest.param("docs/decisions/0012-runtimes.md", instructions, id="instructions"),
    pytest.param("docs/explanation/reliability.md", faults, id="faults"),
    pytest.param("docs/explanation/reliability.md", faults_of_thousands, id="faults_of_thousands"),
    pytest.param("config/default.yaml", paper_in_the_settings, id="paper_in_the_settings"),
)


@pytest.mark.parametrize(("path", "claims"), CLAIMS)
def test_what_a_document_quotes_is_what_its_page_says(path: str, claims: Callable[[], Claims]) -> None:
    made = [flat(claim) for claim in claims()]
    assert made
    assert [claim for claim in made if claim not in document(path)] == [], path
