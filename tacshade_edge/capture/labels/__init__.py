"""Taking labelled frames: readings that a person types, a scale's, and a robot's poses, lined up with the pictures."""
