"""The margin before a slip: how early it announces one, and how often falsely."""
