"""What several sensors' processes and their hand's own have between them."""
