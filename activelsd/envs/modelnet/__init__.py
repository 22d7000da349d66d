"""The ModelNet world: CAD objects from a folder, a zip or this package, looked at from an orbit."""
