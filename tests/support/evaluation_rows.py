"""A row of an evaluation, to be varied."""

from tacshade_edge.studies.evaluate.score import Row

ROW = Row(
    profile="fast",
    sensor="default",
    object="ball",
    image="",
    depth_mm=3.0,
    x_mm=0.0,
    y_mm=0.0,
    rotation_deg=0.0,
    valid=True,
    contact=True,
    saturated=False,
    true_depth_mm=3.0,
    found_depth_mm=2.7,
    depth_error_pct=-10.0,
    me_mm=0.2,
    sd_pct=92.0,
    sd_sum_pct=84.0,
    backward_mm=0.3,
    iou=0.8,
    points=100,
    true_points=120,
    objects=1,
    repaired_px=0,
    degraded="",
)
