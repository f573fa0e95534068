#!/usr/bin/env python3
"""Record a sensor as a LeRobot camera with depth and tactile numbers, and check the data set.

The data set is opened with LeRobot's loader, every pixel is compared, and a policy runs on a frame.

::

    python tools/examples/lerobot/record.py localhost:1883 left-index [--seconds 20] [--root touch]

Run it with a Python that has LeRobot, tacshade-client and lerobot_camera_tacshade;
it does not need this package.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.import_utils import register_third_party_plugins

KEY, DEPTH, TACTILE = (
    "observation.images.touch",
    "observation.images.touch_depth",
    "observation.tactile.touch",
)
FPS, WAIT_S = 20, 20


def main() -> int:
    """Record, read the data set back, and print the comparison as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("broker")
    parser.add_argument("sensor")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument(
        "--root", type=Path, default=Path("touch"), help="a folder that is not there yet"
    )
    args = parser.parse_args()
    register_third_party_plugins()
    from lerobot_camera_tacshade import TACTILE as TACTILE_NAMES
    from lerobot_camera_tacshade import tactile_feature

    # LeRobot's command line makes the same from --robot.cameras='{touch: {type: tacshade, ...}}'.
    config = CameraConfig.get_choice_class("tacshade")(
        broker=args.broker, sensor=args.sensor, use_depth=True
    )
    camera = make_cameras_from_configs({"touch": config})["touch"]
    shape = (camera.height, camera.width, 3)
    features = {
        KEY: {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]},
        # As LeRobot's robots declare a camera with `use_depth`.
        DEPTH: {
            **{
                "dtype": "image",
                "shape": (*shape[:2], 1),
                "names": ["height", "width", "channels"],
            },
            **{"info": {"is_depth_map": True}},
        },
        TACTILE: tactile_feature(),
        # Policies such as ACT take this key only: a robot appends the tactile numbers
        # to its joints.
        "observation.state": {
            "dtype": "float32",
            "shape": (len(TACTILE_NAMES) + 1,),
            "names": ["time_s", *TACTILE_NAMES],
        },
        "action": {"dtype": "float32", "shape": (1,), "names": ["nothing"]},
    }
    name = f"tacshade/{args.sensor}"
    dataset = LeRobotDataset.create(name, FPS, features, root=args.root, use_videos=False)
    seen, depths, late = [], [], 0
    camera.connect()
    began_s = time.monotonic()
    for k in range(round(args.seconds * FPS)):
        picture = camera.async_read(timeout_ms=1000 * WAIT_S)
        seen.append(picture)
        depths.append(camera.read_latest_depth())
        tactile = camera.read_latest_tactile()
        numbers = {TACTILE: tactile, "observation.state": np.array([k / FPS, *tactile], np.float32)}
        nothing = np.zeros(1, np.float32)
        dataset.add_frame(
            {KEY: picture, DEPTH: depths[-1], **numbers, "action": nothing, "task": "be touched"}
        )
        left_s = began_s + (k + 1) / FPS - time.monotonic()
        late += left_s < 0
        time.sleep(max(0.0, left_s))
    took_s = time.monotonic() - began_s
    camera.disconnect()
    dataset.save_episode()
    dataset.finalize()
    found = compared(name, args.root, seen) | more(LeRobotDataset(name, root=args.root), depths)
    print(json.dumps(found | {"seconds": round(took_s, 1), "late": late}))
    return 0


def compared(name: str, root: Path, seen: list[np.ndarray]) -> dict[str, object]:
    """Compare the frames from LeRobot's loader with the recorded ones."""
    from lerobot_camera_tacshade import to_mm

    opened = LeRobotDataset(name, root=root)
    grey_max, equal, error_mm, depth_mm, shear_mm, touched = 0, 0, 0.0, 0.0, 0.0, 0
    for k, expected in enumerate(seen):
        loaded = np.asarray(opened[k][KEY])  # float32 (3, rows, cols), 0 to 1
        found = np.rint(np.moveaxis(loaded, 0, -1) * 255).astype(np.uint8)
        off = np.abs(found.astype(int) - expected)
        grey_max, equal = max(grey_max, int(off.max())), equal + int(not off.any())
        (height, _), (true_height, true_shear) = to_mm(found), to_mm(expected)
        inside = ~np.isnan(true_height)
        error_mm = max(error_mm, float(np.nanmax(np.abs(height - true_height)[inside])))
        depth_mm = max(depth_mm, float(np.nanmax(true_height)))
        shear_mm = max(shear_mm, float(np.nanmax(np.abs(true_shear))))
        touched += bool(np.nanmax(true_height) > 0)
    return {
        "frames": len(opened),
        "recorded": len(seen),
        "shape": list(loaded.shape),
        "frames_equal": equal,
        "greatest_difference_grey": grey_max,
        "greatest_height_difference_mm": round(error_mm, 4),
        "deepest_mm": round(depth_mm, 3),
        "greatest_shear_mm": round(shear_mm, 3),
        "frames_touched": touched,
        "bytes": sum(path.stat().st_size for path in root.rglob("*") if path.is_file()),
    }


def more(opened: LeRobotDataset, depths: list[np.ndarray]) -> dict[str, object]:
    """How far loaded depth maps (in mm) are off the recorded ones (in m), a frame's numbers,
    and a policy's action.
    """
    import torch
    from lerobot.configs.types import FeatureType
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.utils.feature_utils import dataset_to_policy_features

    off = [
        np.abs(np.asarray(opened[k][DEPTH]).squeeze() - 1e3 * depth.squeeze()).max()
        for k, depth in enumerate(depths)
    ]
    features = dataset_to_policy_features(opened.features)
    outputs = {key: each for key, each in features.items() if each.type is FeatureType.ACTION}
    inputs = {key: each for key, each in features.items() if key in (KEY, "observation.state")}
    config = ACTConfig(
        **{
            "input_features": inputs,
            "output_features": outputs,
            "pretrained_backbone_weights": None,
        },
        **{"dim_model": 64, "chunk_size": 4, "n_action_steps": 4, "device": "cpu"},
    )
    names = opened.features[TACTILE]["names"]
    policy, frame = (
        ACTPolicy(config).eval(),
        opened[int(np.argmax([depth.max() for depth in depths]))],
    )
    with torch.inference_mode():
        action = policy.select_action({key: frame[key][None] for key in inputs})
    return {
        "greatest_depth_difference_mm": float(max(off)),
        "depth_keys": list(opened.meta.depth_keys),
        "tactile": {
            name: round(float(x), 3) for name, x in zip(names, frame[TACTILE], strict=True)
        },
        "policy_inputs": sorted(inputs),
        "action": list(action.shape),
    }


if __name__ == "__main__":
    sys.exit(main())
