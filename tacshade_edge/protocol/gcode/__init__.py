"""G-code on a serial line, as Marlin and Klipper understand it."""
