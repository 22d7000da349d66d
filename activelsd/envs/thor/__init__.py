"""AI2-THOR: an agent that walks through a simulated room to name one object."""
