"""Parts of the simulated sensor that only tests and studies use."""
