"""A process that stitches until it is killed: prints a line for each press that is acknowledged."""

from __future__ import annotations

import sys
from pathlib import Path

from support.bumpy_surface import grid_poses, touched
from tacshade_edge.devices.files.stitch_file import About, StitchFile


def main(folder: Path) -> None:
    poses = grid_poses()
    touches = [touched(pose, k) for k, pose in enumerate(poses)]
    file = StitchFile.create(folder, About("killed", 1, 0, 20.0))
    while True:
        for pose, touch in zip(poses, touches, strict=True):
            file.append(touch, pose)
            print("added", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
