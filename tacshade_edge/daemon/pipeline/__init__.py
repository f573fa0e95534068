"""Moves frames from the source to the observers: two threads, the mailbox between them, the ledger."""
