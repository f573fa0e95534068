"""The networks of `sensor.depth.learned`, shipped or fitted,
run by ONNX Runtime on one thread (decision 5).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacshade_edge.files.images import by_number
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.plausibility.label_columns import judge_labels
from tacshade_edge.plausibility.row_order import name_orders
from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.depth import Network, SigmaModel
from tacshade_edge.sensor.depth.sigma import TERMS
from tacshade_edge.sensor.depth.solver import Features
from tacshade_edge.sensor.inference.onnx_weights import (
    layout_of,
    values_of,
    with_values,
    with_weights_of,
)
from tacshade_edge.sensor.inference.sensor_layer import sensor_layer
from tacshade_edge.sensor.profiles import PROFILES, Profile
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.sensor.touch.learning import LEAST_GROUPS, LEAST_ROWS, LearntTouch, learn
from tacshade_edge.sensor.touch.touch_answer import NO_IMPRINT, PLAIN, imprint_of
from tacshade_edge.types import (
    F32,
    F64,
    QUANTITIES,
    U8,
    Calibration,
    FittedNetwork,
    Frame,
    Need,
    Touch,
)

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

WEIGHTS = Path(str(resources.files("tacshade_edge.sensor.inference") / "weights"))
SHEAR = "shear"  # name of the network of shear, which all profiles share


def load_network(name: str, fitted: FittedNetwork | None = None) -> Network:
    """Load a shipped network (`Profile.network`), or a fitted one, and that of shear;
    for one thread at a time.

    Raises ValueError if the fitted weights have another layout.
    """
    return read_network(WEIGHTS / f"{name}.onnx", fitted)


def read_network(onnx: Path, fitted: FittedNetwork | None = None) -> Network:
    """Read an ONNX file and the files next to it: JSON and ``.sensor.onnx``
    (tools/training/export.py).
    """
    own = read_part(onnx, fitted)
    return_free_memory()  # 8 MB for `accurate`
    return replace(own, shear=_shear(), sigma=_sigma(onnx.stem))


@cache
def _shear() -> Network:
    return read_part(WEIGHTS / f"{SHEAR}.onnx")


def read_part(onnx: Path, fitted: FittedNetwork | None = None) -> Network:
    """Read one network.

    Raises ValueError like `load_network`. The features for a touch model come from a second
    session, made for the first of them: it reads the files again, so that no weights are kept for
    it.
    """
    about, (frame, once) = _about(onnx), _files(onnx, fitted)
    # A list, which the first touch fills: its graph takes as much memory as the other, and most
    # sensors answer no touch.
    session, more = _session(in_integers(onnx, frame)), list["InferenceSession"]()
    touch = _touch_file(onnx) if _touch_file(onnx).exists() else None

    def run(white: F32, sensor: F32, features: Features | None = None) -> Sequence[F32]:
        given = {"white": white[None], "sensor": sensor[None]}
        if features is None or touch is None:
            return [answer[0] for answer in session.run(None, given)]
        if not more:
            # Protocol Buffers reads concatenated messages as one message.
            more.append(_session(in_integers(onnx, _files(onnx, fitted)[0]) + touch.read_bytes()))
        *answers, pooled = (answer[0] for answer in more[0].run(None, given))
        features.append(pooled)
        return answers

    return Network(int(about["fold"]), int(about["cells"]), partial(sensor_layer, once), run)


def _files(onnx: Path, fitted: FittedNetwork | None) -> tuple[bytes, bytes]:
    """What runs for every frame and what runs once, with fitted weights if there are any.

    Raises ValueError.
    """
    frame, once = onnx.read_bytes(), onnx.with_suffix(".sensor.onnx").read_bytes()
    if fitted is None:
        return frame, once
    # Weights are numbers end to end: of another layout, they would run and mean nothing.
    if fitted.layout != layout_of(frame, once):
        raise ValueError(f"fitted to another layout than that of {onnx.name}")
    # A calibration holds one array: those of every frame first, then those of once.
    frames = len(values_of(frame))
    return with_values(frame, fitted.weights[:frames]), with_values(once, fitted.weights[frames:])


def in_integers(onnx: Path, frame: bytes) -> bytes:
    """Put the weights of a per-frame network into its integer graph, if it has one
    (tools/training/integer.py).
    """
    # It has no weights of its own and rounds those that it receives when it loads, so fits and
    # calibrations know floats alone (docs/explanation/numerics.md).
    graph = onnx.with_suffix(".integer.onnx")
    return with_weights_of(graph.read_bytes(), frame) if graph.exists() else frame


def network_files(name: str) -> tuple[bytes, bytes]:
    """The shipped ONNX files: the one that runs for every frame,
    and the one that runs once per sensor.
    """
    return _files(WEIGHTS / f"{name}.onnx", None)


def network_size(name: str) -> tuple[int, int]:
    """A shipped network's fold, and the cells along a side of its map."""
    about = _about(WEIGHTS / f"{name}.onnx")
    return int(about["fold"]), int(about["cells"])


@cache
def shipped_layout(name: str) -> str:
    """Layout of a shipped network; fitted weights of another layout cannot run
    (`FittedNetwork.layout`).
    """
    return layout_of(*network_files(name))


def can_run(name: str, fitted: FittedNetwork) -> bool:
    """Whether fitted weights have the layout and the sizes of a shipped network."""
    if fitted.layout != shipped_layout(name):
        return False
    return fitted.weights.shape == (sum(len(values_of(data)) for data in network_files(name)),)


def _sigma(name: str) -> SigmaModel | None:
    """Error model of a shipped network (tools/training/fit_sigma.py); None if it has none."""
    known = json.loads((WEIGHTS / "sigma.json").read_text())["networks"].get(name)
    if known is None:
        return None
    others = (float(known[key]) for key in ("scale_without_presses", "press_offset", "press_slope"))
    return SigmaModel(tuple(float(known["weights"][term]) for term in TERMS), *others)


def touch_networks(name: str, fitted: FittedNetwork | None = None) -> str:
    """SHA-256 of everything that computes a touch model's features (`TouchModel.networks`)."""
    digest = hashlib.sha256()
    for onnx in (WEIGHTS / f"{name}.onnx", WEIGHTS / f"{SHEAR}.onnx"):
        for path in (
            onnx,
            onnx.with_suffix(".sensor.onnx"),
            onnx.with_suffix(".integer.onnx"),
            _touch_file(onnx),
        ):
            digest.update(path.read_bytes())
    if fitted is not None:
        digest.update(fitted.weights.tobytes())
    return digest.hexdigest()


def _about(onnx: Path) -> dict[str, Any]:
    about: dict[str, Any] = json.loads(onnx.with_suffix(".json").read_text())
    return about


def _touch_file(onnx: Path) -> Path:
    """The file with the nodes that pool activations for a touch model
    (tools/training/touch_outputs.py).
    """
    return onnx.with_suffix(".touch.onnx")


def runtime() -> Any:
    """Import ONNX Runtime on demand: `paper` does without its 20 MB."""
    # From 1.29 on, the wheels send reports and write to ~/.cache otherwise. The library reads it
    # once, when it loads. (1.24 to 1.26 leak with every frame on processors with SME2:
    # docs/decisions/0005-onnxruntime.md.)
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    import onnxruntime

    return onnxruntime


def _session(model: bytes) -> InferenceSession:
    onnxruntime = runtime()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    # The arena keeps 2 MB and saves no time.
    options.enable_cpu_mem_arena = False
    # Below errors, it warns about every processor that it does not know.
    options.log_severity_level = 3
    session: InferenceSession = onnxruntime.InferenceSession(
        model, options, providers=["CPUExecutionProvider"]
    )
    return session


def load_networks() -> dict[str, Network]:
    """The networks of all profiles that a calibration is refitted for, by profile."""
    return {
        name: load_network(profile.network) for name, profile in PROFILES.items() if profile.network
    }


# Written before the supervisor forks: the forks share the pages of what none of them changes.
PRELOADED: dict[str, Network] = {}


def preload(profile: Profile) -> None:
    """Load a profile's shipped network for this process and its forks, which share the memory."""
    if profile.network and profile.network not in PRELOADED:
        PRELOADED[profile.network] = load_network(profile.network)


def make_reconstructor(calibration: Calibration, profile: Profile) -> Reconstructor:
    """Make a reconstructor, with the network that the profile names, fitted or shipped; a preloaded
    one is shared: only one thread of a daemon runs it. A touch model learned from other networks is
    replaced by a reason. Objects that were taught are named.
    """
    made = _without_names(calibration, profile)
    if known := calibration.known.get(profile.name):
        # Only where something is taught.
        from tacshade_edge.sensor.inference.object_names import make_namer

        made.namer = make_namer(known, made.rays, calibration.geometry)
    return made


def _without_names(calibration: Calibration, profile: Profile) -> Reconstructor:
    name, touch = profile.network, calibration.touch.get(profile.name)
    if not name:
        return Reconstructor(calibration, profile)
    fitted = calibration.fitted.get(profile.name)
    network = (PRELOADED.get(name) if fitted is None else None) or load_network(name, fitted)
    if touch is None or touch.networks == touch_networks(name, fitted):
        return Reconstructor(calibration, profile, network, touch=touch)
    text = (
        "the touch model was trained with other networks; train the model again: `tacshade-edge "
        "calibrate --labels`"
    )
    return Reconstructor(
        calibration, profile, network, touch=Reason(ReasonCode.TOUCH_NETWORKS, text)
    )


@dataclass(frozen=True, slots=True)
class LabelledFrame:
    """A picture's name in the table, its labels, its group (empty: a group of its own), and its
    file's name.
    """

    name: str
    image: U8
    known: Mapping[str, float]
    group: str = ""
    file: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TouchResult:
    """What a profile learnt from a table: the frames that were used, which the reports number; a
    line for each other one; the rows and groups of each quantity that has too few.
    """

    profile: str
    learnt: LearntTouch
    names: tuple[str, ...]
    left_out: tuple[str, ...]
    too_few: Mapping[str, tuple[int, int]]
    suspected: tuple[Suspicion, ...] = ()


def learn_touch(
    calibration: Calibration, profile: Profile, frames: Iterable[LabelledFrame]
) -> TouchResult:
    """Learn a profile's touch model; the profile must have a network."""
    assert profile.network is not None
    fitted = calibration.fitted.get(profile.name)
    taken: list[F32] = []
    reconstructor = Reconstructor(
        calibration, profile, load_network(profile.network, fitted), touch=taken.append
    )
    kept: list[LabelledFrame] = []
    left_out, groups, imprints, parts = [], [], [], []
    shown: list[Touch | None] = []
    for frame in frames:
        made = reconstructor.step(Frame(0, 0, 0, frame.image), need=Need.TOUCH)
        # A refused frame has no features: the observer was not called.
        if made is None or len(taken) == len(kept):
            left_out.append(f"{frame.name}: {made and made.reason}")
            continue
        kept.append(frame)
        imprints.append(imprint_of(made.objects, made.volume_mm3) if made.contact else NO_IMPRINT)
        parts.append(reconstructor.changed_part)
        shown.append(made.touch)
        # A group of its own, by a name that no table can hold.
        groups.append(frame.group or f"\0{len(kept)}")
    labels = np.array(
        [[one.known.get(name, np.nan) for name in QUANTITIES] for one in kept]
    ).reshape(-1, len(QUANTITIES))
    counts = np.isfinite(labels).sum(axis=0)
    numbers = np.unique(groups, return_inverse=True)[1].astype(np.int64)
    presses = np.array([len(np.unique(numbers[np.isfinite(column)])) for column in labels.T])
    # A label that is the same in all rows teaches nothing.
    varied = np.array([len(np.unique(column[np.isfinite(column)])) > 1 for column in labels.T])
    enough = (counts >= LEAST_ROWS) & (presses >= LEAST_GROUPS) & varied
    used = np.flatnonzero(enough)
    too_few = {
        QUANTITIES[q]: (int(counts[q]), int(presses[q]))
        for q in np.flatnonzero((counts > 0) & ~enough)
    }
    learnt = LearntTouch(None, ())
    if len(used):
        chosen = [QUANTITIES[q] for q in used]
        table = np.stack(taken), np.stack(imprints), np.array(parts)
        learnt = learn(
            *table, chosen, labels[:, used], numbers, touch_networks(profile.network, fitted)
        )
    answered = {report.name for report in learnt.reports if report.seen}
    doubts = _doubts(labels, shown, answered, [frame.file for frame in kept])
    names = tuple(frame.name for frame in kept)
    return TouchResult(profile.name, learnt, names, tuple(left_out), too_few, doubts)


def _doubts(
    labels: F64, shown: Sequence[Touch | None], answered: Collection[str], files: Sequence[str]
) -> tuple[Suspicion, ...]:
    """What is wrong with labels (n, Q), judging by what the frames show without them, and what a
    model answers.
    """
    values = [{} if touch is None else touch.values for touch in shown]
    seen = [
        np.array([np.nan if (value := one.get(name)) is None else value for one in values])
        for name in PLAIN
    ]
    return judge_labels(
        dict(zip(QUANTITIES, labels.T, strict=True)),
        dict(zip(PLAIN, seen, strict=True)),
        learnt=answered,
        orders=name_orders(files, lambda name: by_number(Path(name))),
    )


# Symbol of the unit at the end of a quantity's name.
UNITS = {"mm": "mm", "deg": "°", "n": "N", "nmm": "N mm"}
# Greatest number of rows that a line names.
SHOWN = 5


def report_lines(result: TouchResult) -> Sequence[str]:
    """The result as lines of text."""
    lines = [f"touch model of {result.profile}: {len(result.names)} frames"]
    for each in result.learnt.reports:
        if not each.seen:
            lines.append(
                f"  {each.name}: not visible in these frames (R² {each.r2:.2f}): no answer"
            )
            continue
        unit = UNITS[each.name.rpartition("_")[2]]
        hold = f"90 % intervals hold {100 * each.coverage_90:.0f} %"
        lines.append(f"  {each.name}: off by {each.error:.3g} {unit} (R² {each.r2:.2f}; {hold})")
        if each.contradicting:
            rows = ", ".join(result.names[row] for row in each.contradicting[:SHOWN])
            more = (
                f" and {len(each.contradicting) - SHOWN} more"
                if len(each.contradicting) > SHOWN
                else ""
            )
            lines.append(f"    contradict the others: {rows}{more}")
    return lines
