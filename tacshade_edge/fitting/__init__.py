"""Training the shipped networks on with a sensor's own presses. It alone needs PyTorch (the extra ``fit``)."""
