"""Whatever touches the outside: cameras, files, the broker. They hold no policy and no threads."""
