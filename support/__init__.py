"""What tests stand on, and the tools that watch a running daemon: sensors, a robot, a broker,
files, machines to run on.
"""
