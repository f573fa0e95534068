"""Files that this program reads and writes: whole or not at all, and one clear line where they cannot be used."""
