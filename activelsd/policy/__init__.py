"""LSD-Net: a trunk that sees, a memory over views, and a head that answers or moves."""
