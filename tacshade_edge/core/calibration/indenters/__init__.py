"""Shapes of indenters, and indenters to print."""
