"""Combine several fingers' contacts into the motion of the object that they hold."""
