"""The networks: their weights, and what runs them."""
