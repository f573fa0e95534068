"""What `import tacshade_edge` gives: a thin layer over the core and the devices, in the caller's thread."""
