"""The networks: their weights, and the code that runs them."""
