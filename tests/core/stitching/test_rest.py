from tacshade_edge.core.stitching.rest import REST_NS, RestDetector

FRAME_NS = 33_000_000


def fired(depths: list[float | None]) -> list[int]:
    """Indices of the frames at which a contact came to rest; None is a frame without contact."""
    rest = RestDetector()
    return [k for k, d in enumerate(depths) if rest.update(k * FRAME_NS + 1, d is not None, d or 0.0)]


PRESS = [0.2, 0.8, 1.4, 2.0] + [2.0 + 0.01 * (k % 3) for k in range(30)] + [1.2, 0.5]


def test_once_in_each_contact() -> None:
    hits = fired([None, *PRESS, None, None, *PRESS, None])
    assert len(hits) == 2
    assert 4 + REST_NS // FRAME_NS <= hits[0] <= 4 + REST_NS // FRAME_NS + 3
    assert hits[1] - hits[0] == len(PRESS) + 2


def test_what_moves_does_not_come_to_rest() -> None:
    assert fired([0.05 * k for k in range(1, 60)]) == []
    assert fired([2.0 + 0.2 * (k % 2) for k in range(60)]) == []


def test_a_slow_creep_does_not_come_to_rest() -> None:
    # 0.6 mm/s
    assert fired([1.0 + 0.02 * k for k in range(100)]) == []


def test_too_short_a_contact_does_not_come_to_rest() -> None:
    assert fired([None, *[2.0] * 8, None]) == []
