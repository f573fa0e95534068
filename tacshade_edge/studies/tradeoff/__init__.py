"""Speed against accuracy: profiles, and what differs from them in one thing, on the same presses."""
