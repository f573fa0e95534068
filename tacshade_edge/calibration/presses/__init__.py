"""Compare presses with their stated values, and select those to use."""
