"""The reference in use: taken when asked for, kept over a restart, followed while nothing touches."""
