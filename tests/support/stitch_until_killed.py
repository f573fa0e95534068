"""A process that stitches until it is killed: prints a line for each press that is acknowledged."""

from __future__ import annotations

import sys
from pathlib import Path

from tacshade_edge.storage.stitching.stitch_file import SessionInfo, StitchFile
from tools.testbed.bumpy_surface import grid_poses, press_of


def main(folder: Path) -> None:
    poses = grid_poses()
    presses = [press_of(pose, k) for k, pose in enumerate(poses)]
    file = StitchFile.create(folder, SessionInfo("killed", 1, 0, 20.0))
    while True:
        for pose, points in zip(poses, presses, strict=True):
            file.append(points, pose)
            print("added", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
