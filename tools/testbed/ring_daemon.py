"""The command `run` on a ring of images in memory; a process of ``tools/benchmarks/daemon.py``."""

import signal
import sys
from pathlib import Path

from tacshade_edge.cli.entry import leave
from tacshade_edge.daemon.app import App
from tacshade_edge.factories import calibrations
from tacshade_edge.settings import load
from tools.testbed.daemon_rig import RingSource

config, ring, fps = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
document = load(config)
app = App(document, RingSource(ring, fps), calibrations.load_calibration(document))
signal.signal(signal.SIGTERM, lambda *_: app.stop())
app.run()
leave(0)
