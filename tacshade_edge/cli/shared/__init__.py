"""Parts that several commands share: log, progress, options."""
