"""Furnished rooms, ray-cast: what stands where, what a camera sees of it, and where an agent can stand."""
