"""Study where the error of the learned inverse comes from, by making one part after another perfect."""
