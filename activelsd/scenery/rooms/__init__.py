"""Furnished rooms, ray-cast: their layout, what a camera sees, and where an agent can stand."""
