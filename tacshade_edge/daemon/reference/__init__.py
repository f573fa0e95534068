"""The reference in use: taken on request, kept over a restart, followed while nothing touches."""
