"""The paper's TacShade, as far as its Table I tells:
a sensor on which its method errs as it states.

The paper states neither the sizes of its objects, nor the depth of its presses, nor the print. A
search over all of them found these values (tools/studies/identify_tacshade.py,
docs/results/paper.md); others may do as well.
"""

from __future__ import annotations

from tacshade_edge.lab.simulator.sensor_model import SensorModel

# Digits are those of the search, not of what is known: Table I has ten figures.
TACSHADE = SensorModel(
    skin_radius_mm=21.0359,
    camera_distance_mm=36.4959,
    visible_half_angle_deg=49.1311,
    row_c=239.5,
    col_c=319.5,
    disc_radius_px=220.8,
    pitch_mm=2.3121,
    lattice_rotation_deg=43.7698,
    pin_length_pitches=1.6392,
    pin_tip_radius_pitches=0.3317,
    pin_base_radius_pitches=0.12,
    marker_radius_pitches=0.4877,
    position_tolerance_mm=0.0443,
    size_tolerance=0.0551,
    skin_decay_mm=1.01,
    friction=0.1931,
    drag_decay_mm=7.3569,
    coulomb=1.5315,
    sway=0.2053,
    bulge=0.1753,
    pin_lag=0.134,
    creep_part=0.0453,
    creep_s=0.2066,
    light=222.002,
    vignetting=0.3169,
    marker_reflectance=0.895,
    skin_reflectance=0.1307,
    pin_reflectance=0.0417,
    colour_bgr=(1.0186, 1.0, 0.9506),
    blur_px=0.55,
    read_noise_grey=2.1538,
    shot_noise_grey=2.151,
    surround="dark",
    specular_spots=0,
    print_seed=1,
)
OBJECT_SCALE, DEPTH_MM = 1.395, 3.1
"""The size of the objects (1: those of `press.OBJECTS`) and the depth of the presses that go
with it.
"""
