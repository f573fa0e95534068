"""Objects whose descriptions are known: points in a plane, about which touches scatter by 1."""

from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.sensor.recognition.answer import UNKNOWN, Recogniser, scores
from tacshade_edge.sensor.recognition.metric import Metric, coordinates, learn_metric
from tacshade_edge.types import F32, F64, I64, KnownObject

BETWEEN = 100.0
DIMENSIONS = 4


def metric(scores: F32) -> Metric:
    return Metric(
        middle=np.zeros(DIMENSIONS, np.float32),
        spread=np.full(DIMENSIONS, 100, np.float32),
        axes=np.eye(DIMENSIONS, dtype=np.float32) * 100,
        origin=np.zeros(DIMENSIONS, np.float32),
        between=np.full(DIMENSIONS, BETWEEN, np.float32),
        scores=scores,
        trust=1.0,
    )


def drawn(seed: int, objects: int, touches: int) -> tuple[F64, F32]:
    """Places of objects, and touches of each (objects, touches, dimensions)."""
    random = np.random.default_rng(seed)
    places = random.normal(0, np.sqrt(BETWEEN), (objects, DIMENSIONS))
    made = places[:, None] + random.normal(size=(objects, touches, DIMENSIONS))
    return places, made.astype(np.float32)


def own_scores(count: int) -> F32:
    """Ascending scores of touches with their own object after `count` taught it."""
    _, made = drawn(1, 2000, count + 1)
    taught = made[:, :count].mean(axis=1).astype(np.float64)
    between, counts = np.full(DIMENSIONS, BETWEEN, np.float32), np.full(len(made), float(count))
    found = np.diagonal(scores(between, taught, counts, made[:, count].astype(np.float64)))
    return np.quantile(found, np.arange(1, 100) / 100).astype(np.float32)


SHIPPED = metric(np.stack([own_scores(count) for count in (1, 2, 3)]))


@pytest.mark.parametrize("taught", [1, 3])
def test_touches_of_known_objects_are_named_and_rarely_unknown(taught: int) -> None:
    _, made = drawn(2, 8, taught + 200)
    known = [KnownObject(f"object-{k}", each[:taught]) for k, each in enumerate(made)]
    recogniser = Recogniser(SHIPPED, known)
    answers = [
        (each.name, recogniser.answer(touch[None]))
        for each, touches in zip(known, made, strict=True)
        for touch in touches[taught:]
    ]
    unknown = np.mean([answer == UNKNOWN for _, answer in answers])
    assert unknown < 0.09  # 0.05 of all, and objects that were drawn close together
    named = [(name, answer) for name, answer in answers if answer.name is not None]
    right = np.mean([name == answer.name for name, answer in named])
    claimed = np.mean([answer.probability for _, answer in named if answer.probability])
    assert right > 0.97
    assert claimed == pytest.approx(right, abs=0.03)


def test_objects_that_nobody_taught_are_unknown() -> None:
    _, made = drawn(3, 108, 3)
    known = [KnownObject(f"object-{k}", each) for k, each in enumerate(made[:8])]
    recogniser = Recogniser(SHIPPED, known)
    unknown = [recogniser.answer(each[:1]) == UNKNOWN for each in made[8:]]
    assert np.mean(unknown) > 0.9


def test_several_touches_sharpen_the_answer() -> None:
    near = np.zeros((2, 3, DIMENSIONS), np.float32)
    near[1, :, 0] = 1.5
    recogniser = Recogniser(SHIPPED, [KnownObject("a", near[0]), KnownObject("b", near[1])])
    touches = np.zeros((12, DIMENSIONS), np.float32)
    one, four, twelve = (recogniser.answer(touches[:count]).probability for count in (1, 4, 12))
    assert one is not None
    assert four is not None
    assert twelve is not None
    assert 0.5 < one < four < twelve < 1


def test_a_touch_of_the_object_itself_judges_what_is_unknown() -> None:
    """A user's touches may scatter more than the shipped ones."""
    wide = np.array([[12, 0, 0, 0], [-12, 0, 0, 0], [0, 12, 0, 0], [0, -12, 0, 0]], np.float32)
    lonely = Recogniser(metric(np.full((1, 99), 8, np.float32)), [KnownObject("a", wide[:1])])
    places, _ = drawn(5, 25, 1)
    scattered = [
        KnownObject(f"{k}", wide + place.astype(np.float32)) for k, place in enumerate(places)
    ]
    many = Recogniser(metric(np.full((1, 99), 8, np.float32)), scattered)
    touch = np.array([[8, 8, 0, 0]], np.float32)
    assert lonely.answer(touch) == UNKNOWN
    assert many.answer(touch + places[:1].astype(np.float32)) != UNKNOWN


def test_the_metric_makes_touches_of_one_object_scatter_alike() -> None:
    random = np.random.default_rng(4)
    mixing = random.normal(size=(6, 6))
    places = random.normal(size=(300, 6)) * (30, 10, 3, 1, 0.05, 0.01)
    objects: I64 = np.repeat(np.arange(300), 8)
    touches = ((places[objects] + random.normal(size=(2400, 6))) @ mixing).astype(np.float32)
    found = learn_metric(touches, objects)
    made = coordinates(found, touches)
    means = np.stack([made[objects == k].mean(axis=0) for k in range(300)])
    within = np.cov((made - means[objects]).T) * 8 / 7
    assert made.shape == (2400, len(found.between))
    assert 3 <= made.shape[1] <= 4
    assert (np.diag(within) < 1.05).all()  # the shrinkage makes less of small scatter
    assert (np.diag(within) > 0.4).all()
    np.testing.assert_allclose(np.cov(means.T).diagonal(), found.between + 1 / 8, rtol=0.35)
    assert (np.diff(found.between) <= 0).all()
