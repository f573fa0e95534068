"""Speed against accuracy: profiles and variations of them, on the same presses."""
