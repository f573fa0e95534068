"""Study how soon a slip is reported, and how often falsely."""
