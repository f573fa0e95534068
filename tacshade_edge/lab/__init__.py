"""What simulates, fits, measures and demonstrates: nothing that a running sensor needs.

In: models, calibrations, frames. Out: simulated frames, fitted networks, tables.
Threads: `follow-parent` in each worker of `parallel`; paho's where a trial listens.
Other rooms use: `demo.child`, `demo.demo_hand`, `demo.touchpad`, `fitting.explained`,
    `fitting.fit`, `fitting.identify`, `fitting.lattice`, `fitting.prints`, `mjcf.export`,
    `mjcf.mujoco_sensor`, `mjcf.mujoco_stream`, `parallel`, `pressed_file`, `simulated_source`,
    `simulator.pad`, `simulator.press`, `simulator.render`, `simulator.script`,
    `simulator.sensor_model`, `simulator.tacshade`, `simulator.truth`, `studies.evaluate.accuracy`,
    `studies.evaluate.label_doubts`, `studies.evaluate.labelled`, `studies.evaluate.score`,
    `studies.evaluate.touch_scores`, `studies.evaluate.work`, `studies.markdown`,
    `studies.stitch.map_presses`, `studies.stitch.map_truth`, `studies.tradeoff.judging`,
    `studies.tradeoff.measure`, `studies.tradeoff.tradeoff_report`, `trial.trial`.
"""
