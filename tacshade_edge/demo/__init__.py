"""What `demo` starts: a broker, processes, a simulated sensor that presses a touchpad, a hand."""
