"""Claims about time, memory and numbers."""

from __future__ import annotations

import math
import re

import pytest

from support.result_page import LIMITS_ORDER, PROFILES, ROOT, Claims, Page, rounded


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


def arm_frame() -> Claims:
    page, row = Page("arm-frame"), ("balanced", "contact")
    boards = [page.cell(f"{board}, ms", *row) for board in ("Pi 5 (Cortex-A76, 2.4 GHz)", "Pi 4 (Cortex-A72, 1.8 GHz)")]
    yield (
        f"takes {page.cell('all', *row)} million instructions for a frame in contact, of which shear takes "
        f"{page.cell('shear', *row)} million. The estimated frame time is {boards[0]} ms on a Pi 5 and {boards[1]} ms "
        "on a Pi 4"
    )


CLAIMS = (
    pytest.param("docs/explanation/speed.md", stages, id="stages"),
    pytest.param("docs/explanation/speed.md", as_printed, id="as_printed"),
    pytest.param("docs/explanation/speed.md", iterations, id="iterations"),
    pytest.param("docs/explanation/speed.md", daemon, id="daemon"),
    pytest.param("docs/explanation/speed.md", tradeoff, id="tradeoff"),
    pytest.param("docs/explanation/speed.md", arm_frame, id="arm_frame"),
    pytest.param("docs/explanation/numerics.md", stages_in_numerics, id="stages_in_numerics"),
    pytest.param("docs/explanation/numerics.md", runtime, id="runtime"),
    pytest.param("docs/explanation/numerics.md", arm, id="arm"),
    pytest.param("docs/how-to/service.md", memory, id="memory"),
    pytest.param("docs/how-to/service.md", pre_roll, id="pre_roll"),
    pytest.param("docs/how-to/replay.md", recording, id="recording"),
    pytest.param("docs/decisions/0005-onnxruntime.md", opencv_beside_onnxruntime, id="opencv_beside_onnxruntime"),
    pytest.param("docs/decisions/0012-runtimes.md", instructions, id="instructions"),
    pytest.param("config/default.yaml", paper_in_the_settings, id="paper_in_the_settings"),
)
