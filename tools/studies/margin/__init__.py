"""Study how early the margin announces a slip, and how often it raises a false alarm."""
