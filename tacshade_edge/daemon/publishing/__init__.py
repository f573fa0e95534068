"""What is published of results, maps and health."""
