"""The third family of sensors: its skin's mechanics are MuJoCo's, and it judges only (README.md)."""
