"""Pure: a physical model of the sensor (skin mechanics, pins and markers, camera, objects,
scenes).
"""
