"""Claims about time, memory and numbers."""

from __future__ import annotations

import re

import pytest

from support.result_page import LIMITS_ORDER, ROOT, Claims, Page, rounded


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


def memory() -> Claims:
    text = (ROOT / "docs" / "results" / "memory.md").read_text(encoding="utf-8")
    found = re.findall(r"^ *(\d+)" + r" +([\d.]+)" * 4 + "$", text, re.MULTILINE)
    of = {int(frames): [rounded(mb, 0) for mb in cells] for frames, *cells in found}
    first, last = of[min(of)], of[max(of)]
    yield f"| profile `balanced` ([page](../results/memory.md)) | {first[0]} | {last[0]} | {last[3]} | {last[1]} |"


def million_instructions(profile: str) -> float:
    """What the depth of a frame in contact takes on a board's processor."""
    page = Page("arm")
    return page.number("gate", profile, "contact") + page.number("depth", profile, "contact")


def arm() -> Claims:
    fast, balanced, accurate = (rounded(million_instructions(profile), 1) for profile in LIMITS_ORDER)
    yield (
        f"the depth of a frame in contact takes `fast`, `balanced` and `accurate` {fast}, {balanced} and {accurate} "
        "million instructions"
    )


def arm_frame() -> Claims:
    page, row = Page("arm"), ("balanced", "contact")
    boards = [page.cell(f"{board}, ms", *row) for board in ("Pi 5 (Cortex-A76, 2.4 GHz)", "Pi 4 (Cortex-A72, 1.8 GHz)")]
    yield (
        f"takes {page.cell('all', *row)} million instructions for a frame in contact, of which shear takes "
        f"{page.cell('shear', *row)} million. The estimated frame time is {boards[0]} ms on a Pi 5 and {boards[1]} ms "
        "on a Pi 4"
    )


CLAIMS = (
    pytest.param("docs/explanation/speed.md", stages, id="stages"),
    pytest.param("docs/explanation/speed.md", iterations, id="iterations"),
    pytest.param("docs/explanation/speed.md", daemon, id="daemon"),
    pytest.param("docs/explanation/speed.md", tradeoff, id="tradeoff"),
    pytest.param("docs/explanation/speed.md", arm_frame, id="arm_frame"),
    pytest.param("docs/explanation/numerics.md", stages_in_numerics, id="stages_in_numerics"),
    pytest.param("docs/explanation/numerics.md", arm, id="arm"),
    pytest.param("docs/how-to/service.md", memory, id="memory"),
    pytest.param("docs/how-to/service.md", pre_roll, id="pre_roll"),
    pytest.param("docs/how-to/replay.md", recording, id="recording"),
)
