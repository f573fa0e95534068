"""Makes a sensor's calibration from references and presses, grades it, keeps it in files.

In: images, SENSOR.yaml, PRESSES.csv, LABELS.csv, INDENTERS.yaml. Out: a `Calibration`, CAL.npz and
    the files beside it.
Threads: none.
Other rooms use: `ageing.appearance`, `ageing.wears`, `calibrate`, `files.ageing_file`,
    `files.calibration_file`, `files.capture_folder`, `files.indenter_file`, `files.labels`,
    `files.objects_file`, `files.press_table`, `files.reference_file`, `files.sensor_file`,
    `findings`, `indenters`, `inputs`, `loading`, `press_machine`, `presses.press_check`,
    `presses.press_selection`, `quality`, `reference.pattern`, `reference.references`,
    `reference.stillness`, `reference.visible_circle`, `refit`, `sentences`.
"""
