"""``run`` with several sensors, each on a ring of images in memory; a process of ``tools/bench_hand.py``."""

import signal
import sys
from pathlib import Path

from bench_rig import RingSource

from tacshade_edge.cli.entry import leave
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.supervisor import Supervisor
from tacshade_edge.devices import registry
from tacshade_edge.settings import load_all

config, fps = Path(sys.argv[1]), float(sys.argv[2])
rings = {name: RingSource(Path(name), fps) for name in sys.argv[3:]}  # in the order of the sensors, read once
documents = load_all(config)
mine = Supervisor(documents).run()
if isinstance(mine, int):
    leave(mine)
ring = dict(zip((document.settings.sensor_id for document in documents), sys.argv[3:], strict=True))
app = App(mine, rings[ring[mine.settings.sensor_id]], registry.load_calibration(mine))
signal.signal(signal.SIGTERM, lambda *_: app.stop())
app.run()
leave(0)
