"""How long a frame's road is, from `Grab` to `MqttLink` and within `Reconstructor.step`: counted as a frame goes it."""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

import msgspec
import pytest
from support.running_app import document

from tacshade_edge.core.contact.tracking import follow
from tacshade_edge.core.reconstruct import Reconstructor, step_and_track
from tacshade_edge.daemon.app import App, Siblings
from tacshade_edge.daemon.hand import Lines
from tacshade_edge.daemon.observer import FrameResult
from tacshade_edge.daemon.pipeline import Reconstruct
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.types import IDENTITY_POSE, Calibration, Frame, Reconstruction

STEP = Reconstructor.step.__code__
HELD = (Frame, FrameResult, Reconstruction)
OFFER = MqttLink.offer.__code__
ON_THE_ROAD = {STEP, step_and_track.__code__, follow.__code__, OFFER}
INNER = (ast.FunctionDef, ast.Lambda, ast.DictComp, ast.GeneratorExp, ast.ListComp, ast.SetComp)
MORE = "profile: fast\nserial: {device: /dev/tacshade-none}\n"


class Road(NamedTuple):
    """Functions that a frame goes through, their ``return`` statements, and the names that they give to things."""

    stays: int
    returns: int
    names: int


FROM_GRAB_TO_LINK = Road(stays=14, returns=22, names=81)
WITHIN_STEP = Road(stays=18, returns=7, names=17)
"""Its stays are the functions that it calls."""
SEEN_BY = (
    *("SessionRequests", "Publisher", "Health", "Preview", "References", "UntouchedFrames"),
    *("FingerReporter", "Robot", "ActiveProfile", "Requests"),
)


def no_longer_than(stated: Road, found: Road) -> bool:
    return all(n <= most for n, most in zip(found, stated, strict=True))


def road(codes: Iterable[CodeType]) -> Road:
    bodies = [body(code) for code in codes]
    returns = sum(isinstance(node, ast.Return) for nodes in bodies for node in nodes)
    return Road(len(bodies), returns, sum(len(names(nodes) - {"self"}) for nodes in bodies))


def names(nodes: Iterable[ast.AST]) -> set[str]:
    bound = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return bound | {node.arg for node in nodes if isinstance(node, ast.arg)}


def body(code: CodeType) -> list[ast.AST]:
    """A function's nodes without those of functions and comprehensions in it."""
    (function,) = ast.parse(textwrap.dedent("".join(inspect.getsourcelines(code)[0]))).body
    inner = [node for node in ast.walk(function) if isinstance(node, INNER) and node is not function]
    nested = {node for one in inner for node in ast.walk(one)}
    return [node for node in ast.walk(function) if node not in nested]


def calls_of(work: Callable[[], Any], seen: Callable[[FrameType, Any], Iterable[CodeType]]) -> list[CodeType]:
    """What `seen` finds in the calls and returns of `work`, each once, in order: the package's named functions."""
    found: dict[CodeType, None] = {}

    def profile(frame: FrameType, event: str, given: Any) -> None:
        if event in ("call", "return"):
            found.update(dict.fromkeys(seen(frame, given)))

    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(None)
    return [code for code in found if "/tacshade_edge/" in code.co_filename and not code.co_name.startswith("<")]


@pytest.fixture
def app(tmp_path: Path, calibration: Calibration, pictures: Any, scripted: Any) -> Any:
    """A daemon with a robot, sessions and a hand, that sees one touched frame in this thread."""
    lines = Lines(["hand-1"])
    lines.want(True)
    plain = document(tmp_path, 1, MORE)
    finger = msgspec.structs.replace(plain.settings, hand_T_sensor=IDENTITY_POSE)
    source = scripted([pictures.touched, None])
    yield App(replace(plain, settings=finger), source, calibration, Siblings(lines.fingers["hand-1"]))
    lines.close()


def run(app: App) -> None:
    pipeline = app._pipeline
    pipeline.grab.run()
    pipeline._mailbox.close()
    pipeline.reconstruct.run()


def test_from_grab_to_the_link(app: App) -> None:
    def holders(frame: FrameType, given: Any) -> Iterator[CodeType]:
        """Who is given a frame or what came of it, who gave it to them, and who gives one back."""
        if isinstance(given, HELD):
            yield frame.f_code
        elif given is None and any(isinstance(value, HELD) for value in arguments(frame)):
            yield frame.f_code
            if frame.f_back is not None:
                yield frame.f_back.f_code
        elif frame.f_code is OFFER:
            yield frame.f_code

    held = calls_of(lambda: run(app), holders)
    found = [code for code in held if "/daemon/" in code.co_filename or code in ON_THE_ROAD]
    stays = [code.co_qualname for code in found]
    whole = road(found[: stays.index(OFFER.co_qualname) + 1])
    assert no_longer_than(FROM_GRAB_TO_LINK, whole), (whole, stays)
    assert tuple(name.removesuffix(".see") for name in stays if name.endswith(".see")) == SEEN_BY


def test_nothing_stands_between_reconstruction_and_publisher_nor_behind_it(app: App) -> None:
    def callers(frame: FrameType, given: Any) -> Iterator[CodeType]:
        above: FrameType | None = frame
        while above is not None and frame.f_code is OFFER and above.f_code is not Reconstruct.run.__code__:
            yield above.f_code
            above = above.f_back

    found = [code.co_qualname for code in calls_of(lambda: run(app), callers)]
    assert found == [OFFER.co_qualname, "Publisher._send", "Publisher.see", "Reconstruct._process"]


def arguments(frame: FrameType) -> list[Any]:
    return [frame.f_locals.get(name) for name in frame.f_code.co_varnames[: frame.f_code.co_argcount]]


def test_within_a_step(app: App) -> None:
    def called(frame: FrameType, given: Any) -> Iterator[CodeType]:
        if frame.f_back is not None and frame.f_back.f_code is STEP:
            yield frame.f_code

    found = calls_of(lambda: run(app), called)
    within = road([STEP])._replace(stays=len(found))
    assert no_longer_than(WITHIN_STEP, within), (within, [code.co_qualname for code in found])
