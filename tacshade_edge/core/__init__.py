"""Pure reconstruction: arrays in, values out; no clock, thread, file, socket, log or global."""
