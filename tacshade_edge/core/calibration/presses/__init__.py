"""What a press shows, whether it agrees with what is stated of it, and which presses are used."""
