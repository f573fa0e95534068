from tacshade_edge.core.contact.tracking import Contact, ContactTracker, Tracked
from tacshade_edge.types import Slip

FRAME_NS = 16_666_667


def contact(x_mm: float, y_mm: float = 0.0, dragged_mm: float = 0.0, strain_mm: float = 0.0) -> Contact:
    return Contact(x_mm, y_mm, (dragged_mm, 0.0), strain_mm, 2.0)


def followed(tracker: ContactTracker, *objects: Contact, frame: int = 0) -> tuple[Tracked, ...]:
    return tracker.step(frame * FRAME_NS, objects)


def test_an_object_keeps_its_number_while_it_touches_and_none_is_used_again() -> None:
    tracker = ContactTracker()
    assert [t.id for t in followed(tracker, contact(-5), contact(5))] == [1, 2]
    assert [t.id for t in followed(tracker, contact(5.5), contact(-5.5), frame=1)] == [2, 1]
    assert [t.id for t in followed(tracker, contact(6), frame=2)] == [2]
    assert [t.id for t in followed(tracker, contact(-6), contact(6.5), frame=3)] == [3, 2]
    assert followed(tracker, frame=4) == ()
    assert [t.id for t in followed(tracker, contact(6.5), frame=5)] == [4]


def test_what_the_skin_goes_along_with_does_not_slip() -> None:
    tracker = ContactTracker()
    for k in range(20):
        (found,) = followed(tracker, contact(0.3 * k, dragged_mm=0.3 * k), frame=k)
    assert found.slip is Slip.STICK
    assert found.slip_mm_s is not None
    assert found.slip_mm_s < 1e-6


def test_an_imprint_that_moves_over_the_material_slips_at_its_speed() -> None:
    tracker = ContactTracker()
    speed_mm_s = 5.0
    told = []
    for k in range(20):
        at = speed_mm_s * max(0, k - 10) * FRAME_NS * 1e-9
        (found,) = followed(tracker, contact(2 + at, dragged_mm=2.0), frame=k)
        told.append(found.slip)
    assert found.slip_mm_s is not None
    assert abs(found.slip_mm_s - speed_mm_s) < 0.01
    assert told.index(Slip.FULL) * FRAME_NS <= 10 * FRAME_NS + 100_000_000
    assert Slip.FULL not in told[:11]


def test_skin_that_holds_in_a_part_only() -> None:
    tracker = ContactTracker()
    (found,) = followed(tracker, contact(0, dragged_mm=2.0, strain_mm=0.5))
    assert found.slip is Slip.PARTIAL
    assert found.slip_mm_s is None


def test_a_stream_that_begins_again_has_no_speed_from_before() -> None:
    tracker = ContactTracker()
    for k in range(5):
        followed(tracker, contact(0.5 * k), frame=100 + k)
    (found,) = followed(tracker, contact(2.0), frame=0)
    assert found.slip_mm_s is None
