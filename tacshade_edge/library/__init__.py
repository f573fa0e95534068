"""The public library, `import tacshade_edge`: a thin layer over the core and the devices,
in the caller's thread.
"""
