"""Evaluation: players under one protocol, what is counted of them, and how it is shown."""
