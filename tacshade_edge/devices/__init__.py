"""Access to the outside world: cameras, serial ports, the broker.

No policy, no threads except paho's.
"""
