"""The command for real sensors' frames: its parts that need no set, and the whole on a simulated TacTip's frames."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.studies.evaluate.labelled import FoundRow
from tools.studies import real_frames
from tools.studies.real_frames import RealFrame
from tools.testbed.simulator.tactip import tactip

LIST_HEADER = "Image number, contact, shear_x, shear_y, pose_z, pose_Rx, pose_Ry, shear_Rz \n"
FREE_LINE = "{}, False, 0.00, 0.00, 0.00, 0.00, 0.00, 0.00 \n"


def row(refused: str = "", contact: bool = True, depth_mm: float = 1.0) -> FoundRow:
    return FoundRow("a.png", "fast", refused, contact, False, False, depth_mm, 1.0, 0.0, 0.0, 0.0, 0.0)


def raw_clone(folder: Path, depths_mm: tuple[float, ...]) -> Path:
    """As `aerial_tactile_servoing`: two free frames, then presses of a ball, and a folder of another light."""
    sensor, images = SimulatedSensor(tactip(SensorModel())), folder / "data" / "tactip_images"
    for name in ("first", real_frames.OTHER_LIGHT):
        (images / name).mkdir(parents=True)
        lines = [FREE_LINE.format(1), FREE_LINE.format(2)]
        for k, depth_mm in enumerate((0.0, 0.0, *depths_mm)):
            presses = (Press(ball(6.0), 0.0, 0.0, depth_mm),) if depth_mm else ()
            cv2.imwrite(str(images / name / f"raw_image{k}.png"), sensor.frame(presses, k).image)
        lines += [f"{k + 3}, True, 0.5, -1.0, {d:.2f}, 2.00, -3.00, 0.00 \n" for k, d in enumerate(depths_mm)]
        (images / name / "image_list.csv").write_text(LIST_HEADER + "".join(lines))
    return folder


@pytest.mark.slow
def test_a_whole_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clone = raw_clone(tmp_path, (1.5, 2.0, 2.5, 3.0, 3.5))
    real_frames.report("raw", real_frames.raw_frames(clone), ["fast"])
    out = capsys.readouterr().out
    assert "accepts 2 of 2 free frames" in out
    assert "0 of 7" in out  # refused
    assert "0 of 2" in out  # contacts on free frames
    assert "0 of 5" in out  # presses lost
    depth = next(line for line in out.splitlines() if "| " in line and " depth |" in line)
    assert float(depth.split("|")[4]) == 1.0


def test_frames_of_another_light_are_left_out(tmp_path: Path) -> None:
    frames = real_frames.raw_frames(raw_clone(tmp_path, (2.0,)))
    assert [frame.free for frame in frames] == [True, True, False]
    assert frames[2].path == tmp_path / "data" / "tactip_images" / "first" / "raw_image2.png"
    assert frames[2].known == {
        "depth_mm": 2.0,
        "tilt_x_deg": 2.0,
        "tilt_y_deg": -3.0,
        "shear_x_mm": 0.5,
        "shear_y_mm": -1.0,
    }


def test_plates_are_read_from_their_table(tmp_path: Path) -> None:
    folder = tmp_path / real_frames.PLATES
    folder.mkdir(parents=True)
    header = "sensor_image,object_label,pose_x,pose_y,pose_z,pose_Rx,pose_Ry,pose_Rz,shear_x,shear_y"
    (folder / "targets_images.csv").write_text(
        f"{header}\nimage_4.png,surface,0,0,3.2,-9,1,0,1,2\nimage_9.png,surface,0,0,1.1,8,2,0,3,4\n"
    )
    frames = real_frames.plate_frames(tmp_path)
    assert [frame.known["depth_mm"] for frame in frames] == [3.2, 1.1]
    assert real_frames.reference_candidates(frames) == [folder / "processed_images" / "image_9.png"]


@pytest.mark.parametrize("name", sorted(real_frames.SETS))
def test_no_clone_is_one_line(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"found no frame, expected a clone with (data|dataset)"):
        real_frames.SETS[name](tmp_path)


def test_the_picture_most_like_the_mean_is_the_reference_where_nothing_is_known(tmp_path: Path) -> None:
    frames = []
    for k, grey in enumerate((10, 90, 100, 200)):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((8, 8), grey, np.uint8))
        frames.append(RealFrame(tmp_path / f"{k}.png", None, {}))
    assert real_frames.reference_candidates(frames) == [tmp_path / "2.png"]


def test_refused_false_and_lost_frames_are_counted() -> None:
    free, pressed, unknown = (RealFrame(Path("a.png"), kind, {}) for kind in (True, False, None))
    frames = [free, free, pressed, pressed, pressed, unknown]
    rows = [row("glare"), row(), row("torn"), row(contact=False), row(), row("glare")]
    assert real_frames.summary(frames, rows) == ("fast", "3 of 6", "glare 2, torn 1", "1 of 2", "2 of 3")
    assert real_frames.summary([unknown], [row()]) == ("fast", "0 of 1", "-", "-", "-")


def test_thinned_evenly() -> None:
    frames = [RealFrame(Path(f"{k}.png"), None, {}) for k in range(10)]
    assert [f.path.stem for f in real_frames.thinned(frames, 5)] == ["0", "2", "4", "6", "8"]
    assert real_frames.thinned(frames, 10) == frames
