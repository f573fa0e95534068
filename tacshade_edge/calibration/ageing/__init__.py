"""What ages on a sensor: how it looks beside its reference, and what many days of that mean."""
