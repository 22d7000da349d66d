"""Walks through simulated rooms: AI2-THOR's, drawn by Unity, or rooms drawn here in its stead."""
