"""Each pixel's ray, and the skin point that it sees."""
