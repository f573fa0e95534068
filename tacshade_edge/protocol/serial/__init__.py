"""The robot's serial channel: bytes to values and back."""
