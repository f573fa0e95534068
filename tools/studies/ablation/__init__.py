"""Where the error comes from: the learned inverse with one thing after the other made perfect."""
