from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from tacshade_edge.daemon.observer import FrameResult
from tacshade_edge.daemon.publishing import WIDTH_PX, Preview
from tacshade_edge.types import Frame


class Link:
    """A broker with, or without, somebody who looks."""

    def __init__(self) -> None:
        self.connected = True
        self.listened = True
        self.offered: list[tuple[str, bytes, int]] = []

    def has_listener(self, stream: str) -> bool:
        return self.listened

    def offer(self, *payload: Any) -> None:
        self.offered.append(payload)


def test_the_newest_frame_goes_out_once_even_of_a_contact_whose_depth_nobody_needed(pictures: Any) -> None:
    link = Link()
    preview = Preview(link)  # type: ignore[arg-type]
    preview.publish()
    assert link.offered == []
    for seq in (3, 4):
        preview.see(FrameResult(Frame(seq, 0, 0, pictures.touched), None, None))
    for away, alone in ((True, False), (False, True), (False, False), (False, False)):
        link.connected, link.listened = not away, not alone
        preview.publish()
    ((stream, jpeg, seq),) = link.offered
    assert (stream, seq) == ("preview", 4)
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED).shape == (240, WIDTH_PX)
