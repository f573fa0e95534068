"""The parts that `demo` starts: a broker, processes, a simulated sensor that presses a touchpad,
and a hand.
"""
