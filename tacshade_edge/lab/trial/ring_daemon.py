"""The command `run` with sensors that have rings of images in memory; a process of a trial, of the
benchmarks and the soak test.
"""

import gc
import signal
import sys
from pathlib import Path

from tacshade_edge.calibration import loading
from tacshade_edge.daemon import hand_process as process
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.hand_process import Lines
from tacshade_edge.daemon.supervisor import Supervisor
from tacshade_edge.lab.trial.ring_source import RingSource
from tacshade_edge.settings import Document, Hand, load_all, load_hand


def main(config: Path, fps: float, images: list[str]) -> int:
    """Run the sensors of these settings, each with the ring of its place; return the exit code."""
    rings = {name: RingSource(Path(name), fps) for name in images}  # read once
    documents, hand = load_all(config), load_hand(config)
    lines = Lines(hand.fingers if hand else ())
    ring = dict(zip((document.settings.sensor_id for document in documents), images, strict=True))

    def work(part: Document | Hand) -> int:
        """Run the hand's process or a sensor's."""
        if isinstance(part, Hand):
            process.run(part, lines)
            return 0
        name = part.settings.sensor_id
        app = App(part, rings[ring[name]], loading.load_calibration(part), lines.fingers.get(name))
        signal.signal(signal.SIGTERM, lambda *_: app.stop())
        app.run()
        return 0

    gc.freeze()  # as `run` does
    several = len(documents) > 1
    return Supervisor(documents, hand, lines.end).run(work) if several else work(documents[0])


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3:]))
