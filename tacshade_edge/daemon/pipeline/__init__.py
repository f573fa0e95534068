"""Frames from the source to the sink: two threads, the mailbox between them, the ledger."""
