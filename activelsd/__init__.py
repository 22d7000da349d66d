"""Active vision: an agent that looks, steps and names what it sees, in as few views as it can."""

__version__ = "0.1.0"
