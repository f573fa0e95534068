"""What the fingers of a hand report, put together. Pure: the daemon and the library give it the time."""
