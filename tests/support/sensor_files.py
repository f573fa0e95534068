"""The files that a person hands to `calibrate`, from the simulated sensor."""

from __future__ import annotations

from pathlib import Path

import cv2
import yaml

from support.calibrated_sensor import HALF, presses, references


def write_files(folder: Path) -> list[str]:
    """Write SENSOR.yaml, PRESSES.csv and their images;
    return the words that `calibrate` needs for them.
    """
    keys = {
        "skin_radius_mm": HALF.skin_radius_mm,
        "camera_distance_mm": HALF.camera_distance_mm,
        "visible_half_angle_deg": HALF.visible_half_angle_deg,
        "polarity": "bright",
    }
    (folder / "SENSOR.yaml").write_text(yaml.safe_dump(keys))
    names = []
    for k, image in enumerate(references()):
        names.append(str(folder / f"reference{k}.png"))
        cv2.imwrite(names[-1], image)
    rows = ["image,indenter,radius_mm,depth_mm,x_mm,y_mm"]
    for k, press in enumerate(presses()):
        cv2.imwrite(str(folder / f"press{k}.png"), press.image)
        rows.append(
            f"press{k}.png,ball,{press.radius_mm},{press.depth_mm},{press.x_mm},{press.y_mm}"
        )
    (folder / "PRESSES.csv").write_text("\n".join(rows) + "\n")
    return [
        "--sensor",
        str(folder / "SENSOR.yaml"),
        "--presses",
        str(folder / "PRESSES.csv"),
        "--reference",
        *names,
    ]
