"""One frame of one sensor: looked at, judged, its contact found, its depth and objects computed.
Pure but for `inference`, which reads weights.

In: a `Frame` and a `Calibration`. Out: a `Reconstruction`.
Threads: none.
Other rooms use: `contact.gate`, `contact.objects`, `contact.rest`, `contact.tracking`,
    `contact.untouched`, `depth`, `depth.hybrid_sfs`, `depth.learned`, `depth.sigma`, `frame_check`,
    `frame_check.camera_drift`, `frame_check.foreign_skin`, `frame_check.picture`,
    `frame_check.turned`, `geometry.disc`, `geometry.disc_map`, `image.greyscale`,
    `image.preprocess`, `image.white`, `inference.network`, `inference.object_names`,
    `inference.onnx_weights`, `inference.rest_evidence`, `inference.turned_frames`, `profiles`,
    `recognition.answer`, `recognition.naming`, `reconstruct`, `touch.learning`,
    `touch.touch_answer`.
"""
