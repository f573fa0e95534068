"""What sensors publish, in other tools' own protocols; a process of its own that costs the daemon one subscriber."""
