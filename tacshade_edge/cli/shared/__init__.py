"""What commands share: log, progress, options."""
